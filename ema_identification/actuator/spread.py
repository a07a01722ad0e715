"""What may differ between two healthy units and two days: tolerances and conditions.

A tolerance is estimated from the record within its band (recalibration). A condition is measured
in the record (temperature, bus voltage, rotor angle at the start, noise) and simply used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ema_sim.actuator import Model
from ema_sim.effects import Effects
from ema_sim.parameters import Actuator


class Tolerance(NamedTuple):
    """A parameter of the unit, or of the day, that is not known exactly."""

    name: str
    half_width: float
    """Of the band in which it lies; relative, or in `unit`."""
    unit: str
    shared: bool = True
    """Whether all records of one unit have the same value."""


TOLERANCES: tuple[Tolerance, ...] = (
    Tolerance("motor.phase_resistance", 0.10, "1"),
    Tolerance("motor.phase_inductance", 0.10, "1"),
    Tolerance("motor.dry_friction", 0.10, "1"),
    Tolerance("surface.dry_friction", 0.10, "1"),
    Tolerance("motor.back_emf_constant", 0.03, "1"),
    Tolerance("motor.back_emf_deviation_a", 0.005, "1"),
    Tolerance("motor.back_emf_deviation_b", 0.005, "1"),
    Tolerance("motor.back_emf_deviation_c", 0.005, "1"),
    Tolerance("motor.inertia", 0.10, "1"),
    Tolerance("surface.inertia", 0.10, "1"),
    Tolerance("shaft.stiffness", 0.10, "1"),
    Tolerance("current_sensor_gain.phase_a", 0.01, "1"),
    Tolerance("current_sensor_gain.phase_b", 0.01, "1"),
    Tolerance("current_sensor_gain.phase_c", 0.01, "1"),
    Tolerance("current_sensor_offset.phase_a", 0.05, "A"),
    Tolerance("current_sensor_offset.phase_b", 0.05, "A"),
    Tolerance("current_sensor_offset.phase_c", 0.05, "A"),
    Tolerance("surface_load.constant", 19.0, "N m", shared=False),
)
"""Bands of the fleet; uniform inside."""
N_TOLERANCES = len(TOLERANCES)
PRIOR = 1.0 / math.sqrt(3.0)
"""Standard deviation of a tolerance, in half widths."""
REFERENCE_TEMPERATURE = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """What is known of one test."""

    temperature: float = REFERENCE_TEMPERATURE
    """Of the winding (degC)."""
    bus: float = 0.0
    """Relative deviation of the bus voltage without load."""
    noise: float = 1.0
    """Factor on the sensor noise."""
    start_angle: float = 0.0
    """Electrical rotor angle at the start (rad)."""
    measured: frozenset[str] = field(default_factory=frozenset)
    """Which of ``temperature`` and ``bus`` the record measures."""

    def regressors(self) -> np.ndarray:
        """Return temperature, bus and noise, each about -1 to 1, shape (3,)."""
        return np.array([
            (self.temperature - 15.0) / 55.0, self.bus / 0.1, math.log(self.noise) / math.log(2.0),
        ])


def draw_tolerances(rng: np.random.Generator) -> np.ndarray:
    """Return a unit of the fleet, in half widths."""
    return rng.uniform(-1.0, 1.0, N_TOLERANCES)


def draw_conditions(rng: np.random.Generator) -> Conditions:
    """Return the conditions of a test somewhere, some day."""
    return Conditions(
        temperature=float(rng.uniform(-40.0, 70.0)), bus=float(rng.uniform(-0.1, 0.1)),
        noise=float(np.exp(rng.uniform(math.log(0.5), math.log(2.0)))),
        start_angle=float(rng.uniform(0.0, 2.0 * math.pi)),
    )


def realise(
    model: Model, z: np.ndarray, conditions: Conditions, effects: Effects | None = None
) -> tuple[Actuator, Effects]:
    """Return the actuator and effects of a unit under conditions.

    Parameters
    ----------
    model : the model under test.
    z : ndarray, shape (18,), tolerances in half widths.
    conditions : of the test.
    effects : in place of those of the model.
    """
    value = {t.name: t.half_width * float(x) for t, x in zip(TOLERANCES, z)}
    a, e = model.actuator, model.effects if effects is None else effects
    motor, surface = a.motor, a.surface
    dry_m, dry_s = 1.0 + value["motor.dry_friction"], 1.0 + value["surface.dry_friction"]
    a = a._replace(
        motor=motor._replace(
            phase_resistance=motor.phase_resistance * (1.0 + value["motor.phase_resistance"]),
            phase_inductance=motor.phase_inductance * (1.0 + value["motor.phase_inductance"]),
            back_emf_constant=motor.back_emf_constant * (1.0 + value["motor.back_emf_constant"]),
            **{name: getattr(motor, name) + value[f"motor.{name}"]
               for name in (f"back_emf_deviation_{p}" for p in "abc")},
            inertia=motor.inertia * (1.0 + value["motor.inertia"]),
            dynamic_friction=motor.dynamic_friction * dry_m,
            static_friction=motor.static_friction * dry_m,
        ),
        surface=surface._replace(
            inertia=surface.inertia * (1.0 + value["surface.inertia"]),
            dynamic_friction=surface.dynamic_friction * dry_s,
            static_friction=surface.static_friction * dry_s,
        ),
        shaft=a.shaft._replace(stiffness=a.shaft.stiffness * (1.0 + value["shaft.stiffness"])),
    )
    gain, offset, load = e.current_sensor_gain, e.current_sensor_offset, e.surface_load
    e = e._replace(
        current_sensor_gain=gain._replace(**{
            f: getattr(gain, f) + value[f"current_sensor_gain.{f}"] for f in gain._fields}),
        current_sensor_offset=offset._replace(**{
            f: getattr(offset, f) + value[f"current_sensor_offset.{f}"] for f in offset._fields}),
        surface_load=load._replace(constant=load.constant + value["surface_load.constant"]),
    )
    if "temperature" in conditions.measured or e.winding_temperature == (20.0, -1.1e-3):
        e = e._replace(winding_temperature=e.winding_temperature._replace(
            temperature=conditions.temperature))
    if "bus" in conditions.measured or e.bus_voltage_change.change == 0.0:
        e = e._replace(bus_voltage_change=e.bus_voltage_change._replace(change=conditions.bus))
    return a, e
