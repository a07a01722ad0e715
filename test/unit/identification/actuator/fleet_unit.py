"""Units whose features are linear in all that healthy units differ in: no simulator needed."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.decision.ranks import p_nothing
from ema_identification.actuator.fleet.surrogate import FleetLibrary, NoiseLaw, design
from ema_identification.actuator.fleet.units import of_day, unit_numbers
from ema_identification.actuator.laws.catalogue import variants
from ema_identification.actuator.laws.signatures import unpack
from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.tolerances import RecordConditions
from ema_sim.model_file import load_model_file

FEATURES = 150
UNITS = {
    ("viscous_friction", "coefficient"): 2e-4, ("backlash", "increase"): 1e-3,
    ("load_dependent_friction", "coefficient"): 0.1, ("position_sensor_offset", "offset"): 5e-3,
    ("inverter_voltage_drop", "drop"): 1.5,
}
"""Sizes at which each feature is off by three standard deviations, rms."""
VARIANTS = tuple(v for v in variants() if v.effect in {name for name, _ in UNITS})
MODEL = load_model_file()
SIZE = len(unit_numbers(MODEL.actuator))
OF_DAY = of_day(SIZE)
_rng = np.random.default_rng(7)
BASE = _rng.normal(size=FEATURES)
_rng.normal(size=18 * FEATURES)
ADDED = {key: _rng.normal(scale=3.0, size=FEATURES) for key in UNITS}
STRANGE = _rng.normal(scale=3.0, size=FEATURES)
"""What no effect adds."""
TOLD = np.array([name not in (
    "motor.stribeck_speed", "converters.speed_offset", "noise.position", "start.position",
    "start.twist") for name in unit_numbers(MODEL.actuator)])
"""Which numbers these features tell."""
SLOPES = np.zeros((FEATURES, SIZE))
SLOPES[:, TOLD] = np.random.default_rng(8).normal(scale=1.5, size=(FEATURES, TOLD.sum()))
CONDITIONS = RecordConditions(measured=frozenset({"temperature", "bus"}))
HEALTHY = 480


def features_of(z, effects):
    """Return the features without noise."""
    added = sum(getattr(getattr(effects, e), f) / unit * ADDED[e, f]
                for (e, f), unit in UNITS.items())
    return BASE + SLOPES @ z + added


def run(_model, _spread, _fmap, z, _conditions, seed, effects):
    """Stand for `fleet_features`: noise of one standard deviation."""
    return features_of(z, MODEL.effects if effects is None else effects) + (
        np.random.default_rng(seed).normal(size=FEATURES))


def effects_of(**sizes):
    """Return effects in units of `UNITS`."""
    effects = MODEL.effects
    for (name, field), size in UNITS.items():
        if name in sizes:
            values = getattr(effects, name)._replace(**{field: size * sizes[name]})
            effects = effects._replace(**{name: values})
    return effects


def plain_library():
    """Return the library as it is before it was judged."""
    weights = np.zeros((design(np.zeros((1, SIZE + 4))).shape[1], FEATURES))
    weights[0], weights[1:SIZE + 1] = BASE, SLOPES.T
    rows = [features_of(np.zeros(SIZE), v.effects(np.array([x]), MODEL.effects)) - BASE
            for v in VARIANTS for x in v.levels[0]]
    one = np.ones(FEATURES)
    law = NoiseLaw(quiet=one, noisy=np.zeros((2, FEATURES)), correlation=np.eye(FEATURES))
    return FleetLibrary(
        model=MODEL, spread=None, weights=weights, surrogate=law, repeat=law, carried=0.0,
        signatures=unpack(VARIANTS, np.array(rows)), healthy=np.ones((1, 4)),
        aside=(np.zeros((0, 5)), np.zeros((0, FEATURES))), fmap=FeatureMap(
            plan=SimpleNamespace(segments=(), transitions=()), rate=20_000.0,
            actuator=MODEL.actuator, profile=SimpleNamespace(points=(), name="linear"),
            features=tuple(SimpleNamespace(name=f"f{k}", place="record", signal="s", against="a")
                           for k in range(FEATURES))))


@cache
def judged():
    """Return the library with the scores of healthy units."""
    library, healthy = plain_library(), []
    for seed in range(HEALTHY):
        u = unit(seed=10_000 + seed, library=library)
        healthy.append(scores(u))
    return replace(library, healthy=np.array(healthy))


def p_of(one):
    """Return the share of healthy units that are as far off."""
    return p_nothing(scores(one), one.library.healthy)


def two_days_of(stream, seed):
    """Return what one healthy unit is on two days."""
    rng = np.random.default_rng([seed, stream])
    z = rng.uniform(-1.0, 1.0, SIZE)
    return z, np.where(OF_DAY, rng.uniform(-1.0, 1.0, SIZE), z)


def unit(*, seed=1, strange=0.0, library=None, z=None, **sizes):
    """Return a unit with effects, in units of `UNITS`."""
    rng = np.random.default_rng([seed, 98])
    if z is None:
        z = np.zeros(SIZE)
        z[TOLD] = rng.uniform(-1.0, 1.0, TOLD.sum())
    values = features_of(z, effects_of(**sizes)) + rng.normal(size=FEATURES) + strange * STRANGE
    return TestedUnit(library=judged() if library is None else library, values=values,
                      conditions=CONDITIONS, seed=seed, simulator=run)


def day_beside_unit():
    """Return a library of a test that tells one number of the day from none of the unit, and both.

    As a gain of the current sensors and the motor constant.
    """
    day, own = int(np.flatnonzero(OF_DAY)[0]), int(np.flatnonzero(~OF_DAY)[0])
    plain = plain_library()
    weights = plain.weights.copy()
    weights[1 + day] = weights[1 + own]
    return replace(plain, weights=weights), day, own
