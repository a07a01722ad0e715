"""Features of a simulated fleet: each unit tested when new and again, with and without faults."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ema_prognostics.cascade.classes import OUTPUTS
from ema_prognostics.features.extract import extract
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.training.conditions import (
    HEALTHY,
    InjectedFault,
    RunConditions,
    Unit,
    actuator_of,
    draw_conditions,
    draw_fault,
    draw_pair,
    draw_unit,
    effects_of,
)
from ema_record import array_cache
from ema_record.actuator import load_actuator
from ema_record.errors import RecordError
from ema_record.kit import share_path
from ema_record.profile import load_profile
from ema_sim.model_file import Model, load_model_file
from ema_sim.simulate import simulate

MIX = (("healthy", 0.16), ("turn_short", 0.20), ("static", 0.06), ("rotor_eccentricity", 0.18),
       ("friction", 0.15), ("backlash", 0.09), ("pair", 0.16))
"""What the tests of the training units have, with probabilities."""
TESTS_A_UNIT = 3
MODULE = "ema_prognostics.training.fleet"
"""This module: it decides, with all that it imports, what the features are."""
DATA = ("config/actuator.yaml", "config/profiles/step.yaml", "config/profiles/extended.yaml")
"""Files that decide it too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetFeatures:
    """Features of the records of a fleet.

    Attributes
    ----------
    names : of the features, (d,).
    baseline : ndarray, shape (n, d). Record of the unit when new, healthy.
    record : ndarray, shape (n, d). A later record of the same unit.
    severity : ndarray, shape (n, 8). Columns as `conditions.OUTPUTS`; 0: not present.
    unit : ndarray, shape (n,). Number of the unit.
    friction : ndarray, shape (n, 2). Log of the unit's own friction, motor and surface, over
        nominal.
    """

    names: tuple[str, ...]
    baseline: np.ndarray
    record: np.ndarray
    severity: np.ndarray
    unit: np.ndarray
    friction: np.ndarray

    def __len__(self) -> int:
        """Return the number of pairs of records."""
        return len(self.record)


@dataclass(frozen=True, slots=True, kw_only=True)
class _UnitPlan:
    unit: Unit
    base: RunConditions
    tests: tuple[tuple[RunConditions, InjectedFault], ...]


def _draw(rng: np.random.Generator, healthy: bool) -> _UnitPlan:
    tests = []
    names, shares = [m[0] for m in MIX], np.array([m[1] for m in MIX])
    for _ in range(1 if healthy else TESTS_A_UNIT):
        kind = "healthy" if healthy else str(rng.choice(names, p=shares / shares.sum()))
        fault = draw_pair(rng) if kind == "pair" else draw_fault(rng, kind)
        tests.append((draw_conditions(rng), fault))
    return _UnitPlan(unit=draw_unit(rng), base=draw_conditions(rng), tests=tuple(tests))


def _features(
    kind: ProfileKind, model: Model, unit: Unit, conditions: RunConditions, fault: InjectedFault
) -> dict[str, float]:
    """Return the features of one test, none where the actuator did not do it."""
    try:
        record = simulate(
            load_profile(kind), actuator=actuator_of(model.actuator, unit), seed=conditions.seed,
            effects=effects_of(conditions, fault, model.effects), noise=conditions.noise,
        )
        return extract(record, kind, load_actuator())  # as the diagnosis will see it
    except RecordError:
        return {}


def sources_key(*parts: str) -> str:
    """Return a hash of `parts` and of all that decides the features: simulator, extraction."""
    data = (share_path(name).read_text(encoding="utf-8") for name in DATA)
    return array_cache.key_of(*data, *parts, module=MODULE)


Arrays = dict[str, np.ndarray]


def _run(kind: ProfileKind, model: Model, plans: list[_UnitPlan], key: str, folder: Path | None
         ) -> Arrays:
    """Simulate units and return the features of their records, kept in `folder`.

    Returns
    -------
    ``names``, shape (d,); ``features``, shape (units, 1 + tests, d), the baseline first; NaN: no
    features, the diagnosis answers "unknown" to such a record.
    """
    from threadpoolctl import threadpool_limits

    kept = None if folder is None else array_cache.load(key, folder)
    if kept is not None and set(kept) == {"names", "features"}:
        return kept
    with threadpool_limits(limits=1):
        found = [[_features(kind, model, plan.unit, *test)
                  for test in ((plan.base, HEALTHY), *plan.tests)] for plan in plans]
    names = next((list(values) for tests in found for values in tests if values), [])
    none = [math.nan] * len(names)
    arrays = {"names": np.array(names, dtype=str), "features": np.array(
        [[[v[n] for n in names] if v else none for v in tests] for tests in found])}
    if folder is not None:
        array_cache.save(key, arrays, folder)
    return arrays


def simulate_fleet(
    kind: ProfileKind, units: int, seed: int, *, healthy: bool = False, jobs: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None, chunk: int = 10,
    folder: Path | None = None, model: Model | None = None,
) -> FleetFeatures:
    """Simulate `units` units and return their features.

    Parameters
    ----------
    kind : of the test.
    units : number of units; each has a baseline and three tests (one if `healthy`).
    seed : of everything; the result does not depend on `jobs`.
    healthy : only healthy tests, for the calibration of false alarms.
    jobs : processes.
    progress : called with units done and all units.
    chunk : units a job.
    folder : keeps what is done, so that a campaign that was stopped goes on.
    model : the actuator around which the fleet spreads, with effects that all its units have;
        default the nominal one.
    """
    from joblib import Parallel, delayed

    streams = np.random.SeedSequence([seed, int(healthy)]).spawn(units)
    plans = [_draw(np.random.default_rng(s), healthy) for s in streams]
    of = model or load_model_file()
    parts = [plans[i:i + chunk] for i in range(0, units, chunk)]
    keys = [sources_key(json.dumps([kind, repr(of), seed, healthy, chunk, k]))
            for k in range(len(parts))]
    base, record, severity, number, friction = [], [], [], [], []
    names: list[str] = []
    unit = done = 0
    work = Parallel(n_jobs=jobs, return_as="generator")(
        delayed(_run)(kind, of, part, key, folder) for part, key in zip(parts, keys))
    for part, found in zip(parts, work):
        names = names or found["names"].tolist()
        known = ~np.isnan(found["features"]).all(axis=2)
        for plan, features, known_tests in zip(part, found["features"], known):
            if not known_tests[0]:
                continue
            for k, (_, fault) in enumerate(plan.tests, start=1):
                if known_tests[k]:
                    base.append(features[0])
                    record.append(features[k])
                    severity.append([fault.severity.get(o, 0.0) for o in OUTPUTS])
                    number.append(unit)
                    friction.append(
                        np.log1p([plan.unit.motor_friction, plan.unit.surface_friction]))
            unit += 1
        done = min(done + chunk, units)
        progress(done, units)
    return FleetFeatures(
        names=tuple(names), baseline=np.array(base), record=np.array(record),
        severity=np.array(severity), unit=np.array(number), friction=np.array(friction),
    )
