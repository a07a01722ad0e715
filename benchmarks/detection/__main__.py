"""Detection on a fleet that training never saw: one command, one table, plots.

    python -m benchmarks.detection --out detection

Needs about 30 minutes on two cores; parts that are done are kept in ``--work`` and read again.
The comparison with a plain perceptron needs the features of the training campaign: give its
folder (``ema train --work``) with ``--campaign``, or it is simulated.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.detection.generate import COUNTS, Tested, generate
from benchmarks.detection.judge import VIEWS, Judged, View, judge
from benchmarks.detection.peers import comparison
from benchmarks.detection.report import plot_detection, plot_reliability, print_tables
from benchmarks.detection.table import TARGETS, fault_groups, fault_numbers, numbers
from ema_prognostics.cascade.model_file import load_model
from ema_prognostics.training.fleet import simulate_fleets


def _progress(what: str, started: float) -> None:
    print(f"  [{time.monotonic() - started:5.0f} s] {what}", file=sys.stderr, flush=True)


def _visible(judged: list[Judged]) -> dict[str, float]:
    """Return the severity of each group from which a miss is a mistake: its a90/95."""
    found = {name: fault_numbers(part)["a90_95"] for name, part in fault_groups(judged).items()
             if "," not in name}
    return {name: value for name, value in found.items() if value is not None}


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="new folder of results")
    parser.add_argument("--work", type=Path, default=Path("detection-work"))
    parser.add_argument("--campaign", type=Path, default=None)
    parser.add_argument("--model", type=Path, default=None)
    parser.add_argument("--part", type=float, default=1.0, help="of the fleet")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only-table", action="store_true",
                        help="without the comparison with peers")
    options = parser.parse_args()
    if options.out.exists():
        parser.error(f"{options.out} exists already: give another folder")
    started = time.monotonic()
    model = load_model(options.model)
    fleet: list[Tested] = generate(
        options.work, options.part, jobs=options.jobs,
        progress=lambda k, n: _progress(f"held-out fleet: {k} of {n} units", started)
        if k % 480 == 0 else None,
    )
    judged: dict[View, list[Judged]] = {v: judge(fleet, model, v) for v in VIEWS}
    result: dict[str, Any] = {
        "model": model.sha256, "seed": model.training["seed"], "counts": COUNTS,
        "targets": TARGETS,
        "views": {v: numbers(judged[v], _visible(judged[v])) for v in VIEWS},
    }
    if not options.only_table:
        _progress("training campaign", started)
        size = model.training["settings"]
        campaign = simulate_fleets(
            ("extended",), size["units"], model.training["seed"], jobs=options.jobs,
            folder=options.campaign or options.work)["extended"]
        _progress("peers", started)
        result["comparison"] = comparison(
            campaign, fleet, judged, result["views"]["fleet"]["visible from"], model,
            jobs=options.jobs)
    options.out.mkdir(parents=True)
    (options.out / "detection.json").write_text(json.dumps(result, indent=1) + "\n")
    plot_detection(judged, result["views"], options.out / "detection.png")
    plot_reliability(result["views"], options.out / "reliability.png")
    print_tables(result)
    _progress(f"wrote {options.out}", started)


if __name__ == "__main__":
    main()
