"""What the second simulator is told of a unit and a test beside the description of its type."""

from __future__ import annotations

from typing import NamedTuple


class Own(NamedTuple):
    """Effects that the other simulator does not have."""

    rounding: float = 0.0
    """Of the back-EMF's edges: deviation of a Gaussian blur (rad, electrical)."""
    dead_time: float = 0.0
    """Of the inverter's legs (s); pwm and foc."""
    offset_drift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of the current sensors (A/s)."""
    stribeck: float = 1.25e-3
    """Speed within which static friction has gone, of the slew speed."""


class Surroundings(NamedTuple):
    """Conditions of one test."""

    temperature: float = 20.0
    """Winding and magnets (degC)."""
    bus: float = 0.0
    """Relative change of the bus voltage."""
    load: float = 0.0
    """Torque on the surface (N m)."""
    noise: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factors on the noise of speed, position and current."""
    gain: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Relative errors of the current sensors, which the current control reads too."""
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of the current sensors (A)."""
    start_angle: float = 0.0
    """Of the rotor (rad, mechanical)."""


class Damage(NamedTuple):
    """What is wrong: nothing unless said. The first seven are faults of the catalogue."""

    short: float = 0.0
    """Share x of the turns of `phase`: k, R (1 − x), L (1 − x)²."""
    phase: int = 0
    eccentricity: float = 0.0
    """k_k (1 + ζ cos(θ − angle)), or cos(θ − angle − φ_k) where `shifted`."""
    shifted: bool = False
    angle: float = 0.0
    motor_friction: float = 0.0
    """Relative increases of dry friction."""
    surface_friction: float = 0.0
    backlash: float = 0.0
    """Added (rad)."""
    cogging: float = 0.0
    """N m, six times an electrical turn."""
    demagnetisation: float = 0.0
    """Relative loss of k."""
    sag: float = 0.0
    """Resistance of the supply, both rails (Ω)."""
    resistance: float = 0.0
    """Relative increase in `phase`."""
    hall: float = 0.0
    """The angle sensor reads ahead (rad, electrical)."""
    mesh: float = 0.0
    """Gear error at the surface (rad), 17 times a turn of the motor."""
    event: float = 0.0
    """When a sensor fails (s)."""
    current_offset: float = 0.0
    """Of the sensor of `phase`, from `event` on (A)."""
    current_gain: float = 0.0
    """Relative, of the sensor of `phase`, always."""
    speed_gain: float = 0.0
    """Relative, always."""
    slip: float = 0.0
    """Of the position sensor, from `event` on (rad)."""
