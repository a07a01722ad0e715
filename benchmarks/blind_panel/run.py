"""Identify: ``python -m benchmarks.blind_panel.run --out DIR``, a process locked from the answers.

Sees the tasks, the bags and the kits; one line a unit is kept, nothing is done twice. ``--next``
identifies again where a proposed test was recorded, with that record beside the first one.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from benchmarks.blind_panel.guard import lock
from benchmarks.blind_panel.kits import make_kit
from benchmarks.blind_panel.tasks import (
    ACCEPTED,
    BAGS,
    HELD_OUT,
    IDENTIFIED,
    MEASURED,
    NEXT,
    SEALED,
    Task,
    made_kit,
    on_kit,
    read_tasks,
)
from benchmarks.ledger import Ledger
from ema_identification.identify import identify
from ema_identification.result import Identification
from ema_record.bag.read import read_bag
from ema_record.errors import RecordError
from ema_record.record import Record


def identified(task: Task, out: Path, *, again: bool) -> dict[str, Any]:
    """Return what is said of the bags of a unit; `again`: with the proposed test too."""
    folder = out / BAGS / task.id
    with on_kit(made_kit(task.kit, out) if task.kit else None):
        measured, held_out, accepted = ([read_bag(bag) for bag in sorted(folder.glob(name))]
                                        for name in (MEASURED, HELD_OUT.format("*"),
                                                     ACCEPTED.format("*")))
        if again:
            measured.append(read_bag(folder / NEXT))
        return said_of(measured, held_out, accepted, task.without)


def said_of(measured: Sequence[Record], held_out: Sequence[Record], accepted: Sequence[Record],
            without: Sequence[str]) -> dict[str, Any]:
    """Return what `ema identify --json` says, the test that it proposes, the seconds it took."""
    cpu, wall = time.process_time(), time.perf_counter()
    try:
        found = identify(measured, validate=held_out, without=without, baseline=accepted)
    except RecordError as error:  # a unit that no longer follows its test
        found = Identification(
            verdict="unknown effect", reasons=(str(error),), gap_before=float("nan"),
            gap_after=float("nan"), noise_floor=float("nan"), gap_unit="")
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    proposed = (found.since or found).next_profile
    return {**found.to_dict(), "cpu": cpu, "wall": wall, "next_profile":
            None if proposed is None else proposed.model_dump(mode="json")}


def _identified(task: Task, out: Path, again: bool) -> tuple[str, dict[str, Any]]:
    lock(out / SEALED)
    return f"{task.id}/next" if again else task.id, identified(task, out, again=again)


def main() -> None:
    """Identify what is missing, `--workers` units at a time, each on one core."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--next", action="store_true", help="with the proposed test")
    given = parser.parse_args()
    lock(given.out / SEALED)
    ledger = Ledger(given.out / IDENTIFIED)
    todo = [task for task in read_tasks(given.out) if
            (f"{task.id}/next" not in ledger.keys and (given.out / BAGS / task.id / NEXT).exists()
             if given.next else task.id not in ledger.keys)]
    with Parallel(n_jobs=given.workers, return_as="generator_unordered") as parallel:
        for _ in parallel(delayed(make_kit)(kit, given.out, tests) for kit, tests in
                          sorted({(task.kit, task.tests) for task in todo if task.kit})):
            pass
        for key, said in parallel(delayed(_identified)(task, given.out, given.next)
                                  for task in todo):
            ledger.run(key, partial(dict, said))
            found = said.get("since_baseline", said)
            print(key, found["verdict"],
                  [[f["effect"], *f["equivalent"]] for f in found["findings"]], flush=True)


if __name__ == "__main__":
    main()
