"""Units whose features are linear in all that healthy units differ in: no simulator needed."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
from linear_unit import ADDED, BASE, FEATURES, MODEL, STRANGE, UNITS, VARIANTS

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.fleet import SIZE
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.decision.surrogate import FleetLibrary, NoiseLaw, design
from ema_identification.actuator.measure.tolerances import RecordConditions
from ema_identification.actuator.surrogate.library_runs import unpack

SLOPES = np.random.default_rng(8).normal(scale=1.5, size=(FEATURES, SIZE))
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
    weights = np.zeros((design(np.zeros((1, SIZE + 3))).shape[1], FEATURES))
    weights[0], weights[1:SIZE + 1] = BASE, SLOPES.T
    rows = [features_of(np.zeros(SIZE), v.effects(np.array([x]), MODEL.effects)) - BASE
            for v in VARIANTS for x in v.levels[0]]
    one = np.ones(FEATURES)
    law = NoiseLaw(quiet=one, noisy=0.0 * one, correlation=np.eye(FEATURES))
    return FleetLibrary(
        model=MODEL, spread=None, weights=weights, surrogate=law, repeat=law, carried=0.0,
        signatures=unpack(VARIANTS, np.array(rows)), healthy=np.ones((1, 2)),
        aside=(np.zeros((0, 4)), np.zeros((0, FEATURES))), fmap=SimpleNamespace(
            plan=SimpleNamespace(segments=(), transitions=()), rate=20_000.0, profile=None,
            features=[SimpleNamespace(name=f"f{k}", place="record", signal="s", against="a")
                      for k in range(FEATURES)]))


@cache
def judged():
    """Return the library with the scores of healthy units."""
    library, healthy = plain_library(), []
    for seed in range(HEALTHY):
        u = unit(seed=10_000 + seed, library=library)
        healthy.append(scores(u, u.without_law(), 0))
    return replace(library, healthy=np.array(healthy))


def unit(*, seed=1, strange=0.0, library=None, z=None, **sizes):
    """Return a unit with effects, in units of `UNITS`."""
    rng = np.random.default_rng([seed, 98])
    z = rng.uniform(-1.0, 1.0, SIZE) if z is None else z
    values = features_of(z, effects_of(**sizes)) + rng.normal(size=FEATURES) + strange * STRANGE
    return TestedUnit(library=judged() if library is None else library, values=values,
                      conditions=CONDITIONS, seed=seed, simulator=run)
