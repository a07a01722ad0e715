"""All in which healthy units and days differ, by the kit's `tolerances` and `conditions`.

Beside what recalibration fits, that is everything a record cannot be expected to measure: grease,
static friction, gains, relay band, latencies. One vector in half widths, uniform from -1 to 1,
describes a unit on one day; conditions that the record measures stand beside it.
"""

from __future__ import annotations

import math

import numpy as np

from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.signals import TURN
from ema_identification.actuator.measure.tolerances import (
    TOLERANCES,
    RecordConditions,
    realise,
)
from ema_record.actuator import Actuator
from ema_record.errors import SimulationError
from ema_record.record import Record
from ema_record.spread import TypeSpread
from ema_sim.effects import Effects
from ema_sim.model_file import Model
from ema_sim.simulate import simulate

UNLISTED = (
    "motor.static_ratio", "surface.static_ratio", "motor.viscous_friction",
    "surface.viscous_friction", "motor.flat_top", "shaft.damping", "control.position_gain",
    "control.proportional_gain", "control.integral_gain", "inverter.hysteresis",
    "acquisition.command_latency", "acquisition.reference_latency", "shaft.backlash",
)
"""Beside `TOLERANCES`; lost motion is spread as the stiffness of the same shaft."""
NAMES = (*(t.name for t in TOLERANCES), *UNLISTED)
SIZE = len(NAMES)
_LISTED = len(TOLERANCES)


def _factors(spread: TypeSpread) -> np.ndarray:
    """Return the kit's half widths of `TOLERANCES`, in theirs, shape (18,)."""
    t, c = spread.tolerances, spread.conditions
    kit = [t.resistance, t.inductance, t.motor_friction, t.surface_friction, t.back_emf,
           *[t.back_emf_phase] * 3, t.inertia, t.inertia, t.stiffness, *[c.current_gain] * 3,
           *[c.current_offset] * 3, c.load]
    return np.array([w / known.half_width for w, known in zip(kit, TOLERANCES)])


def draw_fleet_unit(rng: np.random.Generator) -> np.ndarray:
    """Return a healthy unit on some day, shape (SIZE,), in half widths."""
    return rng.uniform(-1.0, 1.0, SIZE)


def draw_fleet_conditions(rng: np.random.Generator, spread: TypeSpread) -> RecordConditions:
    """Return conditions of a test within the kit's."""
    c = spread.conditions
    low, high = math.log(max(c.noise_least, 1e-2)), math.log(max(c.noise_most, 1e-2))
    return RecordConditions(
        temperature=float(rng.uniform(c.temperature_least, c.temperature_most)),
        bus=float(rng.uniform(-c.bus, c.bus)), noise=math.exp(rng.uniform(low, high)),
        start_angle=float(rng.uniform(0.0, TURN)), measured=frozenset({"temperature", "bus"}))


def fleet_unit(
    model: Model, spread: TypeSpread, z: np.ndarray, conditions: RecordConditions,
    effects: Effects | None = None,
) -> tuple[Actuator, Effects]:
    """Return the actuator and effects of a unit.

    Parameters
    ----------
    model, spread : the type.
    z : ndarray, shape (SIZE,), in half widths.
    conditions : of the test.
    effects : in place of those of the model.
    """
    t = spread.tolerances
    a, e = realise(model, z[:_LISTED] * _factors(spread), conditions, effects)
    x = dict(zip(UNLISTED, map(float, z[_LISTED:])))
    m, s, c, q = a.motor, a.surface, a.control, a.acquisition

    def near(name: str, half: float) -> float:
        return 1.0 + half * x[name]

    m = m._replace(
        static_friction=max(m.static_friction * near("motor.static_ratio", t.static_ratio),
                            m.dynamic_friction),
        viscous_friction=m.viscous_friction * t.viscous_factor**x["motor.viscous_friction"],
        flat_top=float(np.clip(m.flat_top + t.flat_top * x["motor.flat_top"], 0.0, math.pi)))
    s = s._replace(
        static_friction=max(s.static_friction * near("surface.static_ratio", t.static_ratio),
                            s.dynamic_friction),
        viscous_friction=s.viscous_friction * t.viscous_factor**x["surface.viscous_friction"])
    c = c._replace(
        position_gain=c.position_gain * near("control.position_gain", t.control_gain),
        proportional_gain=c.proportional_gain * near("control.proportional_gain", t.control_gain),
        integral_gain=c.integral_gain * near("control.integral_gain", t.control_gain))
    shaft = a.shaft._replace(
        damping=a.shaft.damping * near("shaft.damping", t.damping),
        backlash=a.shaft.backlash * near("shaft.backlash", t.stiffness))
    q = q._replace(
        command_latency=q.command_latency
        + 0.5 * t.latency * (1.0 + x["acquisition.command_latency"]),
        reference_latency=q.reference_latency
        + 0.5 * t.latency * (1.0 + x["acquisition.reference_latency"]))
    inverter = a.inverter._replace(
        hysteresis=a.inverter.hysteresis * near("inverter.hysteresis", t.hysteresis))
    return a._replace(motor=m, surface=s, control=c, shaft=shaft, acquisition=q,
                      inverter=inverter), e


def fleet_record(
    model: Model, spread: TypeSpread, fmap: FeatureMap, z: np.ndarray,
    conditions: RecordConditions, seed: int, effects: Effects | None = None,
) -> Record:
    """Return a test of a unit; `fleet_unit` says what the parameters are."""
    actuator, effects = fleet_unit(model, spread, z, conditions, effects)
    # The conditions hold what the sensor of the rotor angle reads.
    angle = conditions.start_angle - effects.hall_misalignment.angle
    return simulate(fmap.profile, actuator=actuator, effects=effects, seed=seed,
                    noise=conditions.noise, rate=fmap.rate, start_angle=angle % TURN)


def fleet_features(
    model: Model, spread: TypeSpread, fmap: FeatureMap, z: np.ndarray,
    conditions: RecordConditions, seed: int, effects: Effects | None = None,
) -> np.ndarray:
    """Return the features of `fleet_record`, shape (d,); NaN outside the simulator's domain."""
    try:
        return fmap.extract(fleet_record(model, spread, fmap, z, conditions, seed, effects))
    except SimulationError:
        return np.full(len(fmap.features), np.nan)
