"""The training campaign: units of a fleet, tested when new and again, features kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ema_prognostics.cascade.classes import OUTPUTS
from ema_prognostics.features.extract import Kind, extract
from ema_prognostics.training.chunks import chunk_file, load_chunk, save_chunk
from ema_prognostics.training.conditions import (
    HEALTHY,
    Conditions,
    Fault,
    Unit,
    actuator_of,
    draw_conditions,
    draw_fault,
    draw_pair,
    draw_unit,
    effects_of,
)
from ema_record.actuator import load_actuator
from ema_record.errors import RecordError
from ema_record.profile import load_profile
from ema_sim.model_file import Model, load_model_file
from ema_sim.simulate import simulate

MIX = (("healthy", 0.16), ("turn_short", 0.20), ("static", 0.06), ("rotor_eccentricity", 0.18),
       ("friction", 0.15), ("backlash", 0.09), ("pair", 0.16))
"""What the tests of the training units have, with probabilities."""
TESTS_A_UNIT = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """Features of a campaign.

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
class _Plan:
    unit: Unit
    base: Conditions
    tests: tuple[tuple[Conditions, Fault], ...]


def _draw(rng: np.random.Generator, healthy: bool) -> _Plan:
    tests = []
    names, shares = [m[0] for m in MIX], np.array([m[1] for m in MIX])
    for _ in range(1 if healthy else TESTS_A_UNIT):
        kind = "healthy" if healthy else str(rng.choice(names, p=shares / shares.sum()))
        fault = draw_pair(rng) if kind == "pair" else draw_fault(rng, kind)
        tests.append((draw_conditions(rng), fault))
    return _Plan(unit=draw_unit(rng), base=draw_conditions(rng), tests=tuple(tests))


def _features(
    kind: Kind, model: Model, unit: Unit, conditions: Conditions, fault: Fault
) -> dict[str, float]:
    record = simulate(
        load_profile(kind), actuator=actuator_of(model.actuator, unit), seed=conditions.seed,
        effects=effects_of(conditions, fault, model.effects), noise=conditions.noise,
    )
    return extract(record, kind, load_actuator())  # as the diagnosis will see it


Found = list[tuple[_Plan, dict[str, float], list[tuple[dict[str, float], Fault]]]]


def _run(kind: Kind, model: Model, plans: list[_Plan], file: Path | None) -> Found:
    """Simulate units and return (plan, baseline, [(test, fault)]) of each, kept in `file`."""
    from threadpoolctl import threadpool_limits

    kept = load_chunk(file)
    if kept is not None:
        return [(plan, base, [(values, plan.tests[k][1]) for k, values in tests])
                for plan, base, tests in zip(plans, *kept) if base]
    bases: list[dict[str, float]] = []
    all_tests: list[list[tuple[int, dict[str, float]]]] = []
    with threadpool_limits(limits=1):
        for plan in plans:
            try:
                base = _features(kind, model, plan.unit, plan.base, HEALTHY)
            except RecordError:
                base = {}
            tests = []
            for k, (conditions, fault) in enumerate(plan.tests if base else ()):
                try:
                    tests.append((k, _features(kind, model, plan.unit, conditions, fault)))
                except RecordError:
                    continue  # the diagnosis answers "unknown" to such a record
            bases.append(base)
            all_tests.append(tests)
    save_chunk(file, bases, all_tests)
    return [(plan, base, [(values, plan.tests[k][1]) for k, values in tests])
            for plan, base, tests in zip(plans, bases, all_tests) if base]


def run_campaign(
    kind: Kind, units: int, seed: int, *, healthy: bool = False, jobs: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None, chunk: int = 10,
    folder: Path | None = None, model: Model | None = None,
) -> Campaign:
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
    parts = [(plans[i:i + chunk], chunk_file(folder, (kind, repr(of), seed, healthy, chunk, i)))
             for i in range(0, units, chunk)]
    base, record, severity, number, friction = [], [], [], [], []
    names: tuple[str, ...] = ()
    unit = done = 0
    work = Parallel(n_jobs=jobs, return_as="generator")(
        delayed(_run)(kind, of, *p) for p in parts)
    for part in work:
        for plan, found, tests in part:
            names = tuple(found)
            for values, fault in tests:
                base.append([found[n] for n in names])
                record.append([values[n] for n in names])
                severity.append([fault.severity.get(o, 0.0) for o in OUTPUTS])
                number.append(unit)
                friction.append(np.log1p([plan.unit.motor_friction, plan.unit.surface_friction]))
            unit += 1
        done = min(done + chunk, units)
        progress(done, units)
    return Campaign(
        names=names, baseline=np.array(base), record=np.array(record),
        severity=np.array(severity), unit=np.array(number), friction=np.array(friction),
    )
