"""Features of a simulated fleet: each unit tested when new and again, with and without faults."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ema_prognostics.cascade.classes import OUTPUTS
from ema_prognostics.features.extract import extract
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.training.conditions import (
    RunConditions,
    Unit,
    actuator_of,
    draw_conditions,
    draw_unit,
    effects_of,
    start_left_by,
)
from ema_prognostics.training.faults import (
    HEALTHY,
    InjectedFault,
    Stranger,
    draw_fault,
    draw_pair,
)
from ema_record import array_cache
from ema_record.actuator import Actuator, load_actuator
from ema_record.errors import RecordError, UsageError
from ema_record.kit import ACTUATOR, PROFILES, kit_path, with_present_kit
from ema_record.profile import load_profile
from ema_record.sources import source_hash
from ema_record.spread import TypeSpread, load_spread
from ema_sim.effects import Effects
from ema_sim.model_file import Model, load_model_file
from ema_sim.simulate import simulate

MIX = (("healthy", 0.16), ("turn_short", 0.20), ("static", 0.06), ("rotor_eccentricity", 0.18),
       ("friction", 0.15), ("backlash", 0.09), ("pair", 0.16))
"""What the tests of the training units have, with probabilities."""
TESTS_A_UNIT = 3
CHUNK = 10
"""Units a job."""
LEAST_FRICTION = 1e-12
"""Floor of a dry friction (N m): there may be none."""
LEAST_UNITS = 0.5
"""Share of the units whose acceptance test must give features."""
MODULE = "ema_prognostics.training.fleet"
"""This module: it decides, with all that it imports, what the features are."""
DATA = (ACTUATOR, f"{PROFILES}/step.yaml", f"{PROFILES}/extended.yaml")
"""Files of the kit that decide it too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetFeatures:
    """Features of the records of a fleet.

    Attributes
    ----------
    names : of the features, (d,).
    baseline : ndarray, shape (n, d). Record of the unit when new, healthy.
    record : ndarray, shape (n, d). A later record of the same unit.
    severity : ndarray, shape (n, 8). Columns as `classes.OUTPUTS`; 0: not present.
    unit : ndarray, shape (n,). Number of the unit.
    friction : ndarray, shape (n, 2). Log of the unit's own friction, motor and surface, over
        nominal.
    strangers : what each record has that is of no class, (n,) or empty.
    """

    names: tuple[str, ...]
    baseline: np.ndarray
    record: np.ndarray
    severity: np.ndarray
    unit: np.ndarray
    friction: np.ndarray
    strangers: tuple[Stranger | None, ...] = ()

    def __len__(self) -> int:
        """Return the number of pairs of records."""
        return len(self.record)

    def both(self, names: Sequence[str]) -> np.ndarray:
        """Return the features `names` of all records, those when new first, shape (2 n, d)."""
        columns = [self.names.index(n) for n in names]
        return np.vstack([self.baseline, self.record])[:, columns]


@dataclass(frozen=True, slots=True, kw_only=True)
class _UnitPlan:
    type: Actuator
    """That the unit is of."""
    unit: Unit
    base: RunConditions
    tests: tuple[tuple[RunConditions, InjectedFault], ...]


DrawFault = Callable[[np.random.Generator], InjectedFault]
DrawType = Callable[[np.random.Generator], Actuator]
"""The type of a unit, where it is not known but as far as this draws it."""


def draw_of_mix(rng: np.random.Generator) -> InjectedFault:
    """Return what a test of a training unit has, by the probabilities of `MIX`."""
    shares = np.array([share for _, share in MIX])
    kind = str(rng.choice([name for name, _ in MIX], p=shares / shares.sum()))
    return draw_pair(rng) if kind == "pair" else draw_fault(rng, kind)


def _draw(rng: np.random.Generator, healthy: bool, spread: TypeSpread, draw: DrawFault,
          draw_type: DrawType) -> _UnitPlan:
    tests = []
    for _ in range(1 if healthy else TESTS_A_UNIT):
        fault = HEALTHY if healthy else draw(rng)
        tests.append((draw_conditions(rng, spread.conditions), fault))
    return _UnitPlan(unit=draw_unit(rng, spread.tolerances),
                     base=draw_conditions(rng, spread.conditions), tests=tuple(tests),
                     type=draw_type(rng.spawn(1)[0]))


def _features(
    kinds: Sequence[ProfileKind], of: Actuator, always: Effects, unit: Unit,
    conditions: RunConditions, fault: InjectedFault,
) -> dict[ProfileKind, dict[str, float]]:
    """Return the features of one test by kind, none where the actuator did not do it.

    A single step begins as the last move has left surface and shaft.
    """
    nominal = load_actuator()  # as the diagnosis will see it
    actuator = actuator_of(of, unit, conditions)
    effects = effects_of(of, unit, conditions, fault, always)
    found: dict[ProfileKind, dict[str, float]] = {}
    for kind in kinds:
        profile = load_profile(kind)
        try:
            record = simulate(
                profile, actuator=actuator, seed=conditions.seed, effects=effects,
                start=start_left_by(actuator, effects, profile, conditions.start)
                if kind == "step" else None)
            found[kind] = extract(record, kind, nominal)
        except RecordError:
            found[kind] = {}
    return found


def sources_key(*parts: str) -> str:
    """Return a hash of `parts` and of all that decides the features: simulator, extraction."""
    files = [kit_path(name) for name in DATA]
    data = (f.read_text(encoding="utf-8") if f.is_file() else "" for f in files)
    return array_cache.key_of(*data, *parts, module=MODULE)


Arrays = dict[str, np.ndarray]


def _run(kinds: tuple[ProfileKind, ...], always: Effects, plans: list[_UnitPlan], key: str,
         folder: Path | None) -> Arrays:
    """Simulate units of the kit and return the features of their records, kept in `folder`.

    By kind ``names_<kind>``, shape (d,); ``features_<kind>``, shape (units, 1 + tests, d), the
    baseline first; NaN: no features, the diagnosis answers "unknown" to such a record.
    """
    from threadpoolctl import threadpool_limits

    kept = None if folder is None else array_cache.load(key, folder)
    if kept is not None and set(kept) == {
            f"{what}_{k}" for k in kinds for what in ("names", "features")}:
        return kept
    with threadpool_limits(limits=1):
        found = [[_features(kinds, plan.type, always, plan.unit, *test)
                  for test in ((plan.base, HEALTHY), *plan.tests)] for plan in plans]
    arrays = {}
    for kind in kinds:
        names = next((list(t[kind]) for tests in found for t in tests if t[kind]), [])
        none = [math.nan] * len(names)
        arrays[f"names_{kind}"] = np.array(names, dtype=str)
        arrays[f"features_{kind}"] = np.array(
            [[[t[kind][n] for n in names] if t[kind] else none for t in tests]
             for tests in found])
    if folder is not None:
        array_cache.save(key, arrays, folder)
    return arrays


def simulate_fleets(
    kinds: tuple[ProfileKind, ...], units: int, seed: int, *, healthy: bool = False,
    jobs: int = 1, progress: Callable[[int, int], None] = lambda _done, _all: None,
    folder: Path | None = None, model: Model | None = None, draw: DrawFault = draw_of_mix,
    draw_type: DrawType | None = None,
) -> dict[ProfileKind, FleetFeatures]:
    """Simulate `units` units and return their features by kind of test.

    Parameters
    ----------
    kinds : of the tests.
    units : number of units; each has a baseline and three tests (one if `healthy`).
    seed : of everything; the result does not depend on `jobs`.
    healthy : only healthy tests, for the calibration of false alarms.
    jobs : processes.
    progress : called with units done and all units.
    folder : keeps what is done, so that a campaign that was stopped goes on.
    model : the actuator around which the fleet spreads, with effects that all its units have;
        default that of the present kit.
    draw : what a test has; a function of a module, which decides the features too.
    draw_type : the actuator around which each unit is drawn, default that of `model`.
    """
    from joblib import Parallel, delayed

    streams = np.random.SeedSequence([seed, int(healthy)]).spawn(units)
    spread, of = load_spread(), model or load_model_file()
    plans = [_draw(np.random.default_rng(s), healthy, spread, draw,
                   draw_type or (lambda _: of.actuator)) for s in streams]
    parts = [plans[i:i + CHUNK] for i in range(0, units, CHUNK)]
    source = "" if draw is draw_of_mix else source_hash(draw.__module__)
    keys = [sources_key(json.dumps([kinds, repr(of), [repr(plan.type) for plan in part], seed,
                                    healthy, CHUNK, k]), source)
            for k, part in enumerate(parts)]
    work = Parallel(n_jobs=jobs, return_as="generator")(
        delayed(with_present_kit(_run))(kinds, of.effects, part, key, folder)
        for part, key in zip(parts, keys))
    results = []
    for result in work:
        results.append(result)
        progress(min(CHUNK * len(results), units), units)
    return {kind: _collected(kind, parts, results, _dry(of.actuator)) for kind in kinds}


def _dry(actuator: Actuator) -> np.ndarray:
    """Return the logarithms of dry friction, motor and surface, shape (2,)."""
    return np.log(np.maximum(
        [actuator.motor.dynamic_friction, actuator.surface.dynamic_friction], LEAST_FRICTION))


def _collected(
    kind: ProfileKind, parts: list[list[_UnitPlan]], results: list[Arrays], nominal: np.ndarray
) -> FleetFeatures:
    """Return the features of one kind of test, units without an acceptance record left out.

    Their own friction is that over the `nominal` one, logarithms of shape (2,).
    """
    base, record, severity, number, friction = [], [], [], [], []
    strangers: list[Stranger | None] = []
    names: list[str] = []
    unit = 0
    for part, arrays in zip(parts, results):
        names = names or arrays[f"names_{kind}"].tolist()
        found = arrays[f"features_{kind}"]
        known = np.atleast_2d(~np.isnan(found).all(axis=2))
        for plan, features, known_tests in zip(part, found, known):
            if not known_tests[0]:
                continue
            for k, (_, fault) in enumerate(plan.tests, start=1):
                if known_tests[k]:
                    base.append(features[0])
                    record.append(features[k])
                    severity.append([fault.severity.get(o, 0.0) for o in OUTPUTS])
                    number.append(unit)
                    strangers.append(fault.stranger)
                    friction.append(_dry(plan.type) - nominal + np.log1p(
                        [plan.unit.motor_friction, plan.unit.surface_friction]))
            unit += 1
    units = sum(map(len, parts))
    if unit < LEAST_UNITS * units:
        raise UsageError(
            f"{units - unit} of {units} simulated healthy units do not do the test {kind!r}, at "
            f"most {100 * (1 - LEAST_UNITS):g} % may fail: check the profile's speed and stroke, "
            "and friction, current limit and tolerances of the actuator.yaml")
    return FleetFeatures(
        names=tuple(names), baseline=np.array(base), record=np.array(record),
        severity=np.array(severity), unit=np.array(number), friction=np.array(friction),
        strangers=tuple(strangers),
    )
