"""Parameters of the actuator: NamedTuples that enter the kernel, with units and bounds.

The bounds are those within which the model is meant to hold; `actuator.load_actuator`
checks them. Values: after Battipede et al.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from pydantic import Field


def _unit(unit: str, lower: float, upper: float, text: str) -> object:
    """Return the pydantic field of a quantity: bounds, unit, meaning."""
    return Field(
        ge=lower, le=upper, allow_inf_nan=False, description=text, json_schema_extra={"unit": unit}
    )


def _count(lower: int, upper: int, text: str) -> object:
    return Field(ge=lower, le=upper, description=text, json_schema_extra={"unit": "1"})


class Inverter(NamedTuple):
    """Three half bridges with a hysteresis current control a phase."""

    bus_voltage: Annotated[float, _unit("V", 1.0, 400.0, "leg voltage, + and -")] = 48.0
    hysteresis: Annotated[float, _unit("A", 0.05, 10.0, "half width of the band")] = 0.5
    current_limit: Annotated[float, _unit("A", 0.1, 500.0, "limit of the reference")] = 22.0


class Motor(NamedTuple):
    """Brushless DC motor: three phases in star, trapezoidal back-EMF."""

    phase_resistance: Annotated[float, _unit("Ω", 1e-3, 100.0, "R of a phase")] = 1.065
    phase_inductance: Annotated[float, _unit("H", 2e-5, 0.1, "L of a phase")] = 0.72e-3
    back_emf_constant: Annotated[float, _unit("V s/rad", 1e-4, 10.0, "k of a phase")] = 0.0376
    back_emf_deviation_a: Annotated[float, _unit("1", -0.5, 0.5, "relative, of phase a")] = 0.0
    back_emf_deviation_b: Annotated[float, _unit("1", -0.5, 0.5, "relative, of phase b")] = 0.0
    back_emf_deviation_c: Annotated[float, _unit("1", -0.5, 0.5, "relative, of phase c")] = 0.0
    flat_top: Annotated[float, _unit("rad", 0.0, 3.0, "width of the trapezoid's top")] = (
        2.0 * math.pi / 3.0
    )
    pole_pairs: Annotated[int, _count(1, 50, "pole pairs")] = 1
    torque_limit: Annotated[float, _unit("N m", 1e-3, 1e4, "saturation of the torque")] = 1.6
    inertia: Annotated[float, _unit("kg m²", 1e-8, 10.0, "inertia of rotor and gear")] = 1.5e-5
    viscous_friction: Annotated[float, _unit("N m s/rad", 0.0, 10.0, "viscous")] = 1e-4
    dynamic_friction: Annotated[float, _unit("N m", 0.0, 1e3, "dry, while moving")] = 0.30
    static_friction: Annotated[float, _unit("N m", 0.0, 1e3, "dry, at standstill")] = 0.40


class Gear(NamedTuple):
    """Reduction gear."""

    ratio: Annotated[float, _unit("1", 1.0, 1e5, "motor rad a surface rad")] = 500.0
    efficiency: Annotated[float, _unit("1", 0.05, 1.0, "of the torque, driving")] = 1.0


class Surface(NamedTuple):
    """Control surface."""

    inertia: Annotated[float, _unit("kg m²", 1e-4, 1e4, "inertia")] = 0.20
    viscous_friction: Annotated[float, _unit("N m s/rad", 0.0, 1e4, "viscous")] = 2.0
    dynamic_friction: Annotated[float, _unit("N m", 0.0, 1e5, "dry, while moving")] = 60.0
    static_friction: Annotated[float, _unit("N m", 0.0, 1e5, "dry, at standstill")] = 90.0
    end_stop: Annotated[float, _unit("rad", 0.01, 10.0, "end stops at + and -")] = 0.6


class Shaft(NamedTuple):
    """Elastic shaft with lost motion between gear and surface."""

    stiffness: Annotated[float, _unit("N m/rad", 1e2, 1e7, "stiffness")] = 1e5
    damping: Annotated[float, _unit("N m s/rad", 0.0, 1e4, "damping")] = 30.0
    backlash: Annotated[float, _unit("rad", 0.0, 0.1, "total lost motion, at the surface")] = 1e-4


class Control(NamedTuple):
    """Position (P) and speed (PI) control."""

    period: Annotated[float, _unit("s", 1e-5, 1e-3, "control period")] = 50e-6
    position_gain: Annotated[float, _unit("1/s", 0.0, 1e6, "speed a position error")] = 2e4
    speed_limit: Annotated[float, _unit("rad/s", 0.1, 1e4, "of the motor")] = 790.6
    proportional_gain: Annotated[float, _unit("A s/rad", 0.0, 1e3, "Kp")] = 0.30
    integral_gain: Annotated[float, _unit("A/rad", 0.0, 1e5, "Ki")] = 60.0


class Converters(NamedTuple):
    """Analogue to digital converters; position and speed close the loop."""

    position_range: Annotated[float, _unit("rad", 0.1, 100.0, "span")] = 2.0
    position_bits: Annotated[int, _count(4, 32, "bits")] = 14
    speed_range: Annotated[float, _unit("rad/s", 1.0, 1e5, "span")] = 2000.0
    speed_bits: Annotated[int, _count(4, 32, "bits")] = 14
    current_range: Annotated[float, _unit("A", 0.1, 1e4, "span, of the record")] = 64.0
    current_bits: Annotated[int, _count(4, 32, "bits")] = 16
    angle_range: Annotated[float, _unit("rad", 6.0, 100.0, "span, of the record")] = 8.0
    angle_bits: Annotated[int, _count(4, 32, "bits")] = 16


class Noise(NamedTuple):
    """White noise, rms a sample at 20 kHz."""

    speed: Annotated[float, _unit("rad/s", 0.0, 100.0, "inside the loop")] = 0.5
    current: Annotated[float, _unit("A", 0.0, 10.0, "on the record only")] = 0.05
    position: Annotated[float, _unit("rad", 0.0, 0.1, "inside the loop")] = 2e-5


class Actuator(NamedTuple):
    """All parameters of one actuator."""

    inverter: Inverter = Inverter()
    motor: Motor = Motor()
    gear: Gear = Gear()
    surface: Surface = Surface()
    shaft: Shaft = Shaft()
    control: Control = Control()
    converters: Converters = Converters()
    noise: Noise = Noise()
