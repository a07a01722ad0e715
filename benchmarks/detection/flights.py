"""The paper's test bench: the flight at which each fault is announced.

Units degrade irregularly over their flights while conditions wander (`sequences`). Every flight
is checked as `ema check` does (record checks on one flight in ten, the cascade on all), with and
without the unit's acceptance record as baseline, and the flights together as `ema trend` does.
Counted are: how many flights lie between passing the detectable severity and the announcement,
false alarms, and faults that were never announced.

    python -m benchmarks.detection.flights --units 36 --work flights

The features of units that are done are kept in the folder `--work` and serve any model; other
sources of the simulator or of the features give other files.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from benchmarks import units as fleet_units
from benchmarks.detection import sequences
from benchmarks.detection.flight_scores import VIEWS, Flown, Score, score_units
from benchmarks.detection.report import make_table, percent
from benchmarks.detection.sequences import draw_course, record_of
from benchmarks.detection.table import TARGETS as BOTH_TARGETS
from benchmarks.detection.table import plain
from ema_cli.console import progress
from ema_prognostics.cascade.model_file import TrainedModel, load_model
from ema_prognostics.features.extract import extract
from ema_prognostics.training.fleet import sources_key
from ema_prognostics.verdict.diagnose import verdict_of_features
from ema_prognostics.verdict.verdict import Verdict
from ema_record.checks.guard import guard_findings, outcome_of
from ema_record.errors import RecordError
from ema_record.files import new_file

TARGETS = {view: {kind: target[k] for kind, target in BOTH_TARGETS.items()}
           for k, view in enumerate(reversed(VIEWS))}
"""Detectable severities unless measured ones are given: those that the issue asks for."""
FLIGHTS = 60
LEAST_FLIGHTS = 12
CHECKED_ONE_IN = 10
"""Flights whose record goes through the record checks too; they take as long as the rest."""


class Test(NamedTuple):
    """One test of a unit."""

    __test__ = False
    features: dict[str, float] | None
    checks: str
    """Outcome of the record checks, empty where they find nothing."""


def measure_unit(unit: int, flights: int) -> list[Test]:
    """Simulate a unit and return its acceptance test and its flights, as features."""
    course = draw_course(unit, flights)
    found = []
    for number in range(flights + 1):
        record = record_of(course, number)
        findings = guard_findings(record) if number % CHECKED_ONE_IN == 0 else []
        try:
            found.append(Test(
                features=extract(record, "extended"),
                checks=outcome_of(findings) if findings else "",
            ))
        except RecordError:
            found.append(Test(features=None, checks="unknown"))
    return found


def judge_unit(unit: int, tests: Sequence[Test], model: TrainedModel) -> Flown:
    """Return the verdicts on the flights of a unit, without and with its baseline."""
    course = draw_course(unit, len(tests) - 1)
    acceptance, *later = tests
    bases = {"fleet": None, "baseline": acceptance.features}
    return Flown(
        unit=unit, kind=course.kind, detail=course.detail, repair=course.repair,
        severity=course.severity,
        verdicts={view: [_verdict(t, model, base) for t in later] for view, base in bases.items()},
    )


def _verdict(test: Test, model: TrainedModel, base: dict[str, float] | None) -> Verdict:
    """Return what `diagnose`, behind the record checks, says of a test."""
    if test.checks or test.features is None:
        return Verdict(outcome=test.checks or "unknown")  # type: ignore[arg-type]
    return verdict_of_features(test.features, "extended", model, base)


def work_file(work: Path, unit: int, flights: int) -> Path:
    """Return where the features of a unit are kept; other sources give another file."""
    own = "".join(Path(module.__file__).read_text() for module in (sequences, fleet_units))
    key = hashlib.sha256(f"{sources_key()} {unit} {flights}{own}".encode()).hexdigest()
    return work / f"unit_{unit:04d}_{key[:16]}.json"


def measure_all(
    units: int, flights: int, work: Path | None,
    progress: Callable[[int], None] = lambda _done: None,
) -> Iterator[list[Test]]:
    """Yield the tests of all units; those done before are read from `work`."""
    for unit in range(units):
        file = None if work is None else work_file(work, unit, flights)
        if file is not None and file.is_file():
            yield [Test(**t) for t in json.loads(file.read_text(encoding="utf-8"))]
        else:
            tests = measure_unit(unit, flights)
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
                with new_file(file) as temporary:
                    temporary.write_text(json.dumps([t._asdict() for t in tests]),
                                         encoding="utf-8")
            yield tests
        progress(unit + 1)


def detectable_of(file: Path | None) -> dict[str, dict[str, float]]:
    """Return the detectable severity (a90/95) by view and fault, from a file or the targets.

    The file is the ``detection.json`` of the detection benchmark. What it could not determine is
    left at the target.
    """
    found = {view: dict(TARGETS[view]) for view in VIEWS}
    if file is not None:
        data = json.loads(file.read_text(encoding="utf-8"))
        for view, kinds in found.items():
            for kind in kinds:
                measured = data["views"][view]["faults"][kind]["a90_95"]
                kinds[kind] = kinds[kind] if measured is None else float(measured)
    return found


def print_score(view: str, score: Score, detectable: dict[str, float]) -> None:
    """Print what one view gave."""
    table = make_table(
        "without a baseline" if view == "fleet" else "with the own baseline",
        "fault", "detectable", "units", "passed", "announced", "confirmed",
        "delay, flights: median (90 % within)")
    for kind, row in score.faults.items():
        delay = np.array(row.announce_delay)
        text = "-"
        if len(delay):
            low, high = np.quantile(delay, [0.05, 0.95])
            text = f"{np.median(delay):+.0f} ({low:+.0f} to {high:+.0f})"
        counts = (row.units, row.passed, row.announced, row.confirmed)
        table.add_row(kind, f"{detectable[kind]:.3g}", *map(str, counts), text)
    Console(width=120).print(table)
    for text, rate in score.rates.items():
        print(f"  {text}: {percent(plain(rate))}")
    for text in score.notes:
        print(f"  {text}")


def main() -> None:
    """Fly the units and print the table."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=24)
    parser.add_argument("--flights", type=int, default=FLIGHTS)
    parser.add_argument("--model", type=Path, help="default the shipped one")
    parser.add_argument("--detectable", type=Path,
                        help="detection.json with the a90/95; default the issue's targets")
    parser.add_argument("--measure-only", action="store_true",
                        help="stop when the features are in --work")
    parser.add_argument("--work", type=Path, help="folder that keeps units that are done")
    parser.add_argument("--out", type=Path, help="JSON file with all numbers")
    options = parser.parse_args()
    if options.flights < LEAST_FLIGHTS:
        parser.error(f"--flights {options.flights}: give at least {LEAST_FLIGHTS}")
    detectable = detectable_of(options.detectable)
    with progress(f"{options.units} units of {options.flights} flights", options.units) as step:
        measured = list(measure_all(options.units, options.flights, options.work, step))
    if options.measure_only:
        return
    model = load_model(options.model)
    flown = [judge_unit(unit, tests, model) for unit, tests in enumerate(measured)]
    print(f"{len(flown)} units of {options.flights} flights; model {model.sha256[:12]}")
    scores = {view: score_units(flown, view, detectable[view]) for view in VIEWS}
    for view, score in scores.items():
        print_score(view, score, detectable[view])
    if options.out is not None:
        with new_file(options.out) as temporary:
            temporary.write_text(json.dumps({
                "model": model.sha256, "units": len(flown), "flights": options.flights,
                "detectable": detectable, **{v: s.to_dict() for v, s in scores.items()},
            }, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
