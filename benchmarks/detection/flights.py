"""The paper's test bench: the flight at which each fault is announced.

Units degrade irregularly over their flights while conditions wander (`sequences`). Every flight
is checked as `ema check` does, with and without the unit's acceptance record as baseline, and
the flights together as `ema trend` does. Counted are: how many flights lie between passing the
detectable severity and the announcement, false alarms, and faults that were never announced.

    python -m benchmarks.detection.flights --units 36 --work flights --plot flights.png

Units that are done are kept in the folder `--work` and read again; another model or other
sources give other files.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.detection.flight_scores import VIEWS, Flown, Score, score_units
from benchmarks.detection.sequences import VERSION, draw_course, record_of
from ema_prognostics.diagnosis import diagnose
from ema_prognostics.guarded import guarded
from ema_prognostics.model_file import Model, load_model
from ema_prognostics.robust.rates import Rate
from ema_prognostics.verdict import Fault, Verdict
from ema_record.files import new_file
from ema_sim.compile import source_hash

TARGETS = {
    "fleet": {"turn_short": 0.015, "rotor_eccentricity": 0.008, "motor_friction": 0.30,
              "surface_friction": 0.30, "backlash": 2e-4},
    "baseline": {"turn_short": 0.005, "rotor_eccentricity": 0.006, "motor_friction": 0.05,
                 "surface_friction": 0.05, "backlash": 1.5e-4},
}
"""Detectable severities unless measured ones are given: those that the issue asks for."""
FLIGHTS = 60


def fly_unit(unit: int, flights: int, model: Model) -> Flown:
    """Simulate and check all flights of a unit, without and with its baseline."""
    course = draw_course(unit, flights)
    baseline = record_of(course, 0)
    verdicts: dict[str, list[Verdict]] = {view: [] for view in VIEWS}
    for flight in range(1, flights + 1):
        record = record_of(course, flight)
        verdicts["fleet"].append(guarded(record, lambda r: diagnose(r, model)))
        verdicts["baseline"].append(
            guarded(record, lambda r: diagnose(r, model, baseline=baseline))
        )
    return Flown(unit=unit, kind=course.kind, detail=course.detail, repair=course.repair,
                 severity=course.severity, verdicts=verdicts)


def judging_hash(model: Model) -> str:
    """Return a hash of all that decides a verdict: model, simulator, sources."""
    digest = hashlib.sha256(f"{VERSION} {model.sha256} {source_hash()}".encode())
    package = Path(__file__).parents[2] / "ema_prognostics"
    for file in sorted([*package.glob("*.py"), *package.glob("robust/*.py")]):
        if not file.name.startswith(("trend", "train", "paper_")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _to_json(flown: Flown) -> dict[str, Any]:
    return {
        "unit": flown.unit, "kind": flown.kind, "detail": flown.detail, "repair": flown.repair,
        "severity": flown.severity.tolist(),
        "verdicts": {
            view: [{"outcome": v.outcome, "faults": [f.to_dict() for f in v.faults],
                    "alternatives": list(v.alternatives), "probabilities": v.probabilities,
                    "reasons": list(v.reasons)} for v in verdicts]
            for view, verdicts in flown.verdicts.items()
        },
    }


def _verdict(data: dict[str, Any]) -> Verdict:
    faults = tuple(
        Fault(**{**f, "severity_interval":
                 None if f["severity_interval"] is None else tuple(f["severity_interval"])})
        for f in data["faults"]
    )
    return Verdict(outcome=data["outcome"], faults=faults, reasons=tuple(data["reasons"]),
                   alternatives=tuple(data["alternatives"]), probabilities=data["probabilities"])


def fly_all(
    units: int, flights: int, model: Model, work: Path | None,
    progress: Callable[[int], None] = lambda _done: None,
) -> Iterator[Flown]:
    """Yield all units; those done before are read from `work`."""
    key = judging_hash(model)[:16]
    for unit in range(units):
        file = None if work is None else work / f"unit_{unit:04d}_{flights}_{key}.json"
        if file is not None and file.is_file():
            data = json.loads(file.read_text(encoding="utf-8"))
            yield Flown(
                unit=data["unit"], kind=data["kind"], detail=data["detail"],
                repair=data["repair"], severity=np.array(data["severity"]),
                verdicts={v: [_verdict(x) for x in found]
                          for v, found in data["verdicts"].items()},
            )
        else:
            flown = fly_unit(unit, flights, model)
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
                with new_file(file) as temporary:
                    temporary.write_text(json.dumps(_to_json(flown)), encoding="utf-8")
            yield flown
        progress(unit + 1)


def detectable_of(file: Path | None) -> dict[str, dict[str, float]]:
    """Return the detectable severity (a90/95) by view and fault, from a file or the targets.

    The file is a JSON object ``{"fleet": {"turn_short": 0.012, ...}, "baseline": {...}}``, or
    the table of the detection benchmark, in which ``detectable`` holds it.
    """
    if file is None:
        return TARGETS
    data = json.loads(file.read_text(encoding="utf-8"))
    data = data.get("detectable", data)
    return {view: {**TARGETS[view], **{k: float(x) for k, x in data.get(view, {}).items()
                                       if x is not None}} for view in VIEWS}


def rate_text(found: Rate) -> str:
    """Return a rate with its bounds and count."""
    if not found.total:
        return "none"
    return (f"{100 * found.value:.2f} % ({100 * found.lower:.2f} to {100 * found.upper:.2f}), "
            f"{found.hits} of {found.total}")


def print_score(view: str, score: Score, detectable: dict[str, float]) -> None:
    """Print what one view gave."""
    print(f"\n{'without a baseline' if view == 'fleet' else 'with the own baseline'}")
    print(f"  {'fault':<20}{'detectable':>11}{'units':>7}{'passed':>8}{'announced':>11}"
          f"{'confirmed':>11}{'delay, flights: median (90 % within)':>40}")
    for kind, row in score.faults.items():
        delay = np.array(row.announce_delay)
        text = "-"
        if len(delay):
            low, high = np.quantile(delay, [0.05, 0.95])
            text = f"{np.median(delay):+.0f} ({low:+.0f} to {high:+.0f})"
        print(f"  {kind:<20}{detectable[kind]:>11.3g}{row.units:>7}{row.passed:>8}"
              f"{row.announced:>11}{row.confirmed:>11}{text:>40}")
    for text, rate in score.rates.items():
        print(f"  {text}: {rate_text(rate)}")
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
                        help="JSON with a90/95 by view and fault, default the issue's targets")
    parser.add_argument("--work", type=Path, help="folder that keeps units that are done")
    parser.add_argument("--out", type=Path, help="JSON file with all numbers")
    parser.add_argument("--plot", type=Path, help="PNG file")
    options = parser.parse_args()
    model = load_model(options.model)
    detectable = detectable_of(options.detectable)
    from ema_cli.console import progress

    with progress(f"{options.units} units of {options.flights} flights", options.units) as step:
        flown = list(fly_all(options.units, options.flights, model, options.work, step))
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
    if options.plot is not None:
        from benchmarks.detection.flights_plot import plot_flights

        plot_flights(flown, scores, detectable, options.plot)


if __name__ == "__main__":
    main()
