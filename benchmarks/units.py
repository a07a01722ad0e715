"""Units and conditions of flights and of the bounds of `benchmarks.detection`.

A narrower fleet than the kit's `tolerances` and `conditions` (config/actuator.yaml), with numbers
of its own: stiffness ±10 %, noise × 0.5 to 2, no spread of gains, latencies or viscous friction.
Nothing of the training's generator is imported. Bus voltage and winding temperature are in the
bags, as the aircraft measures them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ema_record.actuator import Actuator, load_actuator

UNIT_SPREAD: dict[str, float] = {
    "phase_resistance": 0.10, "phase_inductance": 0.10, "motor_friction": 0.10,
    "surface_friction": 0.10, "back_emf_constant": 0.03, "motor_inertia": 0.10,
    "surface_inertia": 0.10, "stiffness": 0.10, "back_emf_a": 0.005, "back_emf_b": 0.005,
    "back_emf_c": 0.005,
}
"""Half widths, relative; uniform."""
CONDITION_SPREAD: dict[str, float] = {
    "surface_load.constant": 19.0,
    **{f"current_sensor_gain.phase_{phase}": 0.01 for phase in "abc"},
    **{f"current_sensor_offset.phase_{phase}": 0.05 for phase in "abc"},
}
"""Half widths in N m, 1, A; uniform; not measured."""
TEMPERATURE = (-40.0, 70.0)
"""degC, measured."""
BUS_CHANGE = (-0.1, 0.1)
"""Relative, measured."""
NOISE = (-1.0, 1.0)
"""Power of two of the factor on the sensor noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """One actuator under test, by its deviations from nominal and its conditions."""

    spread: dict[str, float]
    """Relative deviations, keys of `UNIT_SPREAD`."""
    conditions: dict[str, float]
    """Effects that stand for conditions, dotted names."""
    noise: float


def draw_unit(rng: np.random.Generator) -> Unit:
    """Draw a unit and the conditions of its tests."""
    spread = {name: float(rng.uniform(-half, half)) for name, half in UNIT_SPREAD.items()}
    conditions = {
        name: float(rng.uniform(-half, half)) for name, half in CONDITION_SPREAD.items()
    }
    conditions["winding_temperature.temperature"] = float(rng.uniform(*TEMPERATURE))
    conditions["bus_voltage_change.change"] = float(rng.uniform(*BUS_CHANGE))
    return Unit(spread=spread, conditions=conditions, noise=float(2.0 ** rng.uniform(*NOISE)))


def actuator_of(spread: Mapping[str, float], base: Actuator | None = None) -> Actuator:
    """Return the parameters of a unit.

    Parameters
    ----------
    spread : relative deviations, keys of `UNIT_SPREAD`; one that is left out is zero.
    base : parameters to start from, default nominal.
    """
    a = base if base is not None else load_actuator()
    s = {**dict.fromkeys(UNIT_SPREAD, 0.0), **spread}
    motor = a.motor._replace(
        phase_resistance=a.motor.phase_resistance * (1.0 + s["phase_resistance"]),
        phase_inductance=a.motor.phase_inductance * (1.0 + s["phase_inductance"]),
        back_emf_constant=a.motor.back_emf_constant * (1.0 + s["back_emf_constant"]),
        back_emf_deviation_a=s["back_emf_a"], back_emf_deviation_b=s["back_emf_b"],
        back_emf_deviation_c=s["back_emf_c"],
        inertia=a.motor.inertia * (1.0 + s["motor_inertia"]),
        dynamic_friction=a.motor.dynamic_friction * (1.0 + s["motor_friction"]),
        static_friction=a.motor.static_friction * (1.0 + s["motor_friction"]),
    )
    surface = a.surface._replace(
        inertia=a.surface.inertia * (1.0 + s["surface_inertia"]),
        dynamic_friction=a.surface.dynamic_friction * (1.0 + s["surface_friction"]),
        static_friction=a.surface.static_friction * (1.0 + s["surface_friction"]),
    )
    shaft = a.shaft._replace(stiffness=a.shaft.stiffness * (1.0 + s["stiffness"]))
    return a._replace(motor=motor, surface=surface, shaft=shaft)
