"""What each channel that a recorder lacks, and each poorer recorder, costs in a90.

One fleet of the present kit's actuator is simulated once; of each record the features are taken
as every recorder would have it, channels that it lacks rebuilt. For each recorder the cascades
without and with a baseline are trained on the same units and judged on the same others. Beside
them stands the bound of the best linear detector on the same features (`linear_bound`), which
depends less on a small training.

    python -m benchmarks.any_actuator.channels --units 150 --work channels-work
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from joblib import Parallel, delayed
from rich.console import Console
from threadpoolctl import threadpool_limits

from benchmarks.detection.report import make_table
from ema_prognostics.cascade.classes import FAULTS, OUTPUTS
from ema_prognostics.cascade.find import Cascade
from ema_prognostics.commission.bound import linear_bound
from ema_prognostics.features.extract import extract
from ema_prognostics.training.conditions import (
    actuator_of,
    draw_conditions,
    draw_unit,
    effects_of,
)
from ema_prognostics.training.evaluation import evaluate
from ema_prognostics.training.faults import HEALTHY, draw_fault, draw_pair
from ema_prognostics.training.fleet import MIX, TESTS_A_UNIT, FleetFeatures, sources_key
from ema_prognostics.training.view_training import train_view
from ema_prognostics.words import name_of, scaled
from ema_record import array_cache
from ema_record.actuator import Actuator, load_actuator
from ema_record.channels import (
    ALL,
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
)
from ema_record.errors import RecordError
from ema_record.files import new_file
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_record.spread import load_spread
from ema_sim.effects import Effects
from ema_sim.simulate import simulate

KIND = "extended"
SEED = 970_000
BITS_LESS = 3
THIRD = ALL[PHASE_CURRENTS][-1:]
REFERENCES = ALL[REFERENCE_CURRENTS]


def _without(*columns: int) -> Callable[[Record, Actuator], tuple[Record, Actuator]]:
    def poorer(record: Record, a: Actuator) -> tuple[Record, Actuator]:
        samples = record.samples.copy()
        samples[:, columns] = np.nan
        return replace(record, samples=samples), a

    return poorer


def half_the_rate(record: Record, a: Actuator) -> tuple[Record, Actuator]:
    """Return the record of half the samples: means of two, the angle's across its jump."""
    n = len(record) // 2 * 2
    pairs = record.samples[:n].reshape(-1, 2, record.samples.shape[1])
    samples = pairs.mean(axis=1)
    samples[:, ROTOR_ANGLE] = np.mod(np.unwrap(pairs[:, :, ROTOR_ANGLE], axis=1).mean(axis=1),
                                     2.0 * np.pi)
    rate = 0.5 * a.acquisition.rate
    return replace(record, samples=samples), a._replace(
        acquisition=a.acquisition._replace(rate=rate))


def coarser(record: Record, a: Actuator) -> tuple[Record, Actuator]:
    """Return the record of converters with `BITS_LESS` bits less."""
    c = a.converters
    samples = record.samples.copy()
    fewer = {f"{name}_bits": getattr(c, f"{name}_bits") - BITS_LESS
             for name in ("position", "speed", "current")}
    for name, columns in (("speed", [MOTOR_SPEED]), ("position", [SURFACE_POSITION]),
                          ("current", [*ALL[PHASE_CURRENTS], *REFERENCES])):
        step = getattr(c, f"{name}_range") / 2.0 ** fewer[f"{name}_bits"]
        samples[:, columns] = step * np.round(samples[:, columns] / step)
    return replace(record, samples=samples), a._replace(converters=c._replace(**fewer))


RECORDERS: dict[str, Callable[[Record, Actuator], tuple[Record, Actuator]]] = {
    "all channels": _without(),
    "no third current": _without(*THIRD),
    "no reference currents": _without(*REFERENCES),
    "no rotor angle": _without(ROTOR_ANGLE),
    "no surface position": _without(SURFACE_POSITION),
    "time, speed, two currents": _without(*THIRD, *REFERENCES, ROTOR_ANGLE, SURFACE_POSITION),
    "half the rate": half_the_rate,
    f"{BITS_LESS} bits less": coarser,
}


class _Unit(NamedTuple):
    """Features of the tests of a unit by recorder, shape (1 + tests, d); severities (tests, 8)."""

    features: dict[str, np.ndarray]
    names: dict[str, list[str]]
    severity: np.ndarray
    friction: np.ndarray


def _unit(seed: np.random.SeedSequence, healthy: bool) -> _Unit:
    """Simulate the tests of one unit, drawn as the training draws them."""
    rng, spread, nominal = np.random.default_rng(seed), load_spread(), load_actuator()
    unit = draw_unit(rng, spread.tolerances)
    shares = np.array([m[1] for m in MIX])
    tests = [(draw_conditions(rng, spread.conditions), HEALTHY)]
    for _ in range(1 if healthy else TESTS_A_UNIT):
        kind = "healthy" if healthy else str(
            rng.choice([m[0] for m in MIX], p=shares / shares.sum()))
        fault = draw_pair(rng) if kind == "pair" else draw_fault(rng, kind)
        tests.append((draw_conditions(rng, spread.conditions), fault))
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in RECORDERS}
    for conditions, fault in tests:
        record = simulate(
            load_profile(KIND), actuator=actuator_of(nominal, unit, conditions),
            effects=effects_of(nominal, unit, conditions, fault, Effects()), seed=conditions.seed)
        for name, recorder in RECORDERS.items():
            rows[name].append(extract(*_of_kind(*recorder(record, nominal))))
    names = {name: list(found[0]) for name, found in rows.items()}
    return _Unit(
        features={r: np.array([[row[n] for n in names[r]] for row in found])
                  for r, found in rows.items()},
        names=names,
        severity=np.array([[f.severity.get(o, 0.0) for o in OUTPUTS] for _, f in tests[1:]]),
        friction=np.log1p([unit.motor_friction, unit.surface_friction]))


def _of_kind(record: Record, actuator: Actuator) -> tuple[Record, Any, Actuator]:
    return record, KIND, actuator


def _kept(seed: np.random.SeedSequence, healthy: bool, key: str, folder: Path | None
          ) -> _Unit | None:
    """Return the unit, from `folder` where it is there; None where it does not do the test."""
    stored = None if folder is None else array_cache.load(key, folder)
    if stored is not None:
        return _Unit(features={r: stored[f"x {r}"] for r in RECORDERS},
                     names={r: stored[f"n {r}"].tolist() for r in RECORDERS},
                     severity=stored["severity"], friction=stored["friction"])
    try:
        with threadpool_limits(limits=1):
            unit = _unit(seed, healthy)
    except RecordError:
        return None
    if folder is not None:
        array_cache.save(key, {
            **{f"x {r}": x for r, x in unit.features.items()},
            **{f"n {r}": np.array(n) for r, n in unit.names.items()},
            "severity": unit.severity, "friction": unit.friction}, folder)
    return unit


def fleet_of(units: int, seed: int, *, healthy: bool, jobs: int, folder: Path | None
             ) -> dict[str, FleetFeatures]:
    """Return the features of a fleet by recorder."""
    streams = np.random.SeedSequence([seed, int(healthy)]).spawn(units)
    keys = [sources_key("channels", Path(__file__).read_text(encoding="utf-8"),
                        json.dumps([seed, healthy, k])) for k in range(units)]
    found = [unit for unit in Parallel(n_jobs=jobs)(
        delayed(_kept)(s, healthy, key, folder) for s, key in zip(streams, keys))
        if unit is not None]
    number = np.concatenate([np.full(len(u.severity), k) for k, u in enumerate(found)])
    return {r: FleetFeatures(
        names=tuple(found[0].names[r]),
        baseline=np.vstack([np.repeat(u.features[r][:1], len(u.severity), axis=0)
                            for u in found]),
        record=np.vstack([u.features[r][1:] for u in found]),
        severity=np.vstack([u.severity for u in found]), unit=number,
        friction=np.vstack([np.repeat(u.friction[None], len(u.severity), axis=0)
                            for u in found])) for r in RECORDERS}


def judged(fleets: Sequence[FleetFeatures]) -> dict[str, Any]:
    """Return validation and bounds of one recorder: of faults, healthy, held-out fleets."""
    faults, healthy, held, held_healthy = fleets
    with threadpool_limits(limits=1):
        fleet, own = (Cascade(train_view(faults, healthy, KIND, view, seed=1, hidden=12,
                                         iterations=120)) for view in ("fleet", "baseline"))
        return {
            "features": len(faults.names),
            "fleet": evaluate(fleet, None, held, held_healthy),
            "baseline": evaluate(fleet, own, held, held_healthy),
            "bound": {"fleet": linear_bound(faults, healthy, own=False),
                      "baseline": linear_bound(faults, healthy, own=True)}}


def rows_of(found: dict[str, dict[str, Any]], view: str) -> list[list[str]]:
    """Return the rows of a table: a90 and, in brackets, the linear bound, by recorder."""
    rows = []
    for name, one in found.items():
        cells = [name, str(one["features"])]
        for fault in FAULTS:
            scale = scaled(fault)[0]
            values = (one[view][fault]["a90"], one["bound"][view].get(fault))
            a90, bound = ("-" if v is None else f"{scale * v:.2g}" for v in values)
            cells.append(f"{a90} ({bound})")
        healthy = one[view]
        cells += [f"{100 * healthy[what]['count'] / healthy[what]['total']:.1f}"
                  for what in ("false alarms", "healthy called unknown")]
        rows.append(cells)
    return rows


def main() -> None:
    """Simulate, train for each recorder, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=600,
                        help="units with faults that train, as many healthy; half validate")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--work", type=Path, help="keeps what was simulated")
    parser.add_argument("--out", type=Path, help="JSON file with all numbers")
    o = parser.parse_args()
    half = max(o.units // 2, 1)
    fleets = [fleet_of(n, seed, healthy=healthy, jobs=o.jobs, folder=o.work)
              for n, seed, healthy in ((o.units, SEED, False), (o.units, SEED, True),
                                       (half, SEED + 1, False), (half, SEED + 1, True))]
    found = dict(zip(RECORDERS, Parallel(n_jobs=o.jobs)(
        delayed(judged)([fleet[name] for fleet in fleets]) for name in RECORDERS)))
    units = ", ".join(f"{name_of(f)} {scaled(f)[1]}" for f in FAULTS)
    for view in ("fleet", "baseline"):
        table = make_table(f"a90 (linear bound), {view}; {o.units} + {o.units} units train, "
                           f"{half} + {half} validate; {units}",
                           "recorder", "features", *(name_of(f) for f in FAULTS),
                           "false alarms %", "unknown %")
        for row in rows_of(found, view):
            table.add_row(*row)
        Console(width=140).print(table)
    if o.out is not None:
        with new_file(o.out) as temporary:
            temporary.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
