"""Ports: where effects enter the equations, each a plain sum or product of its effects.

An effect that is neutral returns at once, so its term is exactly absent.
"""

from __future__ import annotations

from ema_sim.compile import law

from ema_sim.effects import Effects
from ema_sim.effects import (
    backlash,
    motor_friction,
    rotor_eccentricity,
    surface_friction,
    turn_short,
    viscous_friction,
)
from ema_sim.electrical import THIRD, TURN, trapezoid
from ema_sim.parameters import Actuator, Motor


@law
def phase_resistance(e: Effects, motor: Motor, phase: int) -> float:
    """Winding port: resistance of a phase (Ω)."""
    return motor.phase_resistance * turn_short.resistance_factor(e.turn_short, phase)


@law
def phase_inductance(e: Effects, motor: Motor, phase: int) -> float:
    """Winding port: inductance of a phase (H)."""
    return motor.phase_inductance * turn_short.inductance_factor(e.turn_short, phase)


@law
def back_emf_constant(
    e: Effects, motor: Motor, phase: int, theta_e: float, theta_r: float
) -> float:
    """Winding port: k_k(θ) of a phase (V s/rad) at electrical and mechanical rotor angle."""
    theta = theta_e - phase * THIRD
    if theta < 0.0:
        theta += TURN
    return (
        motor.back_emf_constant
        * trapezoid(theta, motor.flat_top)
        * turn_short.k_factor(e.turn_short, phase)
        * rotor_eccentricity.k_factor(e.rotor_eccentricity, phase, theta_r)
    )


@law
def added_motor_torque(
    e: Effects, motor: Motor, k_a: float, k_b: float, k_c: float, omega: float
) -> float:
    """Motor torque port: what adds to the electromagnetic torque (N m)."""
    return -turn_short.drag_torque(
        e.turn_short, k_a, k_b, k_c, motor.phase_resistance, omega
    )


@law
def motor_dry_friction(e: Effects, motor: Motor) -> tuple[float, float]:
    """Friction port: dynamic and static budget of the motor side (N m)."""
    dynamic = motor.dynamic_friction + motor_friction.budget(
        e.motor_friction, motor.dynamic_friction
    )
    static = motor.static_friction + motor_friction.budget(
        e.motor_friction, motor.static_friction
    )
    return max(0.0, dynamic), max(0.0, static)


@law
def motor_viscous_friction(e: Effects, motor: Motor, omega: float) -> float:
    """Friction port: viscous torque of the motor side (N m)."""
    return motor.viscous_friction * omega + viscous_friction.torque(e.viscous_friction, omega)


@law
def surface_dry_friction(e: Effects, a: Actuator) -> tuple[float, float]:
    """Friction port: dynamic and static budget of the surface (N m)."""
    dynamic = a.surface.dynamic_friction + surface_friction.budget(
        e.surface_friction, a.surface.dynamic_friction
    )
    static = a.surface.static_friction + surface_friction.budget(
        e.surface_friction, a.surface.static_friction
    )
    return max(0.0, dynamic), max(0.0, static)


@law
def lost_motion(e: Effects, a: Actuator) -> float:
    """Transmission port: total backlash (rad at the surface)."""
    return backlash.lost_motion(e.backlash, a.shaft.backlash)
