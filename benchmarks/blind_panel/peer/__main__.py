"""Sparse regression on the panel: ``python -m benchmarks.blind_panel.peer --out DIR --python PY``.

``PY`` is an interpreter that has ``requirements.txt``. Resumable, one JSON a unit in the form
of the workflow's, so that one scorer judges both. Two ways to choose STLSQ's threshold: on
effect-free units of the peer's own (the default), or by cross-validation within each record
(``--by-validation``), as it is commonly done.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.blind_panel.guard import lock
from benchmarks.blind_panel.layout import PEER, PEER_CV, SEALED, TESTS, add_common, part_of
from benchmarks.blind_panel.peer.solve import NULL_UNITS, calibrated_thresholds, call
from benchmarks.blind_panel.tasks import Task, read_tasks, share
from benchmarks.units import actuator_of, draw_unit
from ema_cli.console import track
from ema_record.bag.read import read_bag
from ema_record.files import new_file
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_sim.effects.settings import effects_from_mapping
from ema_sim.simulate import simulate

NULL_SEED = 550_001


def null_records(count: int) -> list[Record]:
    """Return records of effect-free units, for the thresholds: the panel's spreads, own seeds."""
    records = []
    for k in range(count):
        unit = draw_unit(np.random.default_rng([NULL_SEED, k]))
        records.append(simulate(
            load_profile("extended"), actuator=actuator_of(unit.spread),
            effects=effects_from_mapping(unit.conditions), seed=NULL_SEED + k, noise=unit.noise))
    return records


def solve(task: Task, folder: Path, python: str, request: dict[str, Any]) -> dict[str, Any]:
    """Return the peer's answer on one unit."""
    start = time.perf_counter()
    solved = call(read_bag(folder / task.id / "measured"), python, request, task.without)
    findings = _findings(solved["active"])
    return {
        "verdict": "explained" if findings else "no disagreement", "findings": findings,
        "unknown": None, "next_profile": None, "gap_before": None, "gap_after": None,
        "noise_floor": None, "error": "", "active": solved["active"],
        "seconds": time.perf_counter() - start,
    }


def _findings(active: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one finding an effect (or set of parallel ones) with an active law."""
    sets: dict[frozenset[str], None] = {}
    for law in active:
        sets[frozenset(name.partition(".")[0] for name in law["laws"].split("|"))] = None
    return [{"effect": min(names), "equivalent": sorted(names)[1:], "parameters": []}
            for names in sets]


def main() -> None:
    """Read the command line and run."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_common(parser)
    parser.add_argument("--python", required=True, help="interpreter that has pysindy")
    parser.add_argument("--by-validation", action="store_true",
                        help="choose the threshold by cross-validation")
    given = parser.parse_args()
    lock(given.out / SEALED)
    folder = given.out / (PEER_CV if given.by_validation else PEER)
    folder.mkdir(exist_ok=True)
    tasks = [t for t in share(read_tasks(given.out), part_of(given.part))
             if (given.out / TESTS / t.id / "measured").exists()
             and not (folder / f"{t.id}.json").exists()]
    with threadpool_limits(limits=1):
        request: dict[str, Any] = {}
        if not given.by_validation:
            path = given.out / "peer_thresholds.json"
            records = [] if path.exists() else null_records(NULL_UNITS)
            request = {"thresholds": calibrated_thresholds(path, records, given.python)}
        for task in track(tasks, "sparse regression", len(tasks)):
            answer = solve(task, given.out / TESTS, given.python, request)
            with new_file(folder / f"{task.id}.json") as temporary:
                temporary.write_text(json.dumps(answer), encoding="utf-8")
    print(f"part {given.part}: {len(tasks)} units by sparse regression")


if __name__ == "__main__":
    main()
