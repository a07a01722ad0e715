"""The workflow on the panel: ``python -m benchmarks.blind_panel.run --out DIR [--part N/M]``.

Sees bags and the task list; the answers are locked away from this process. One JSON a unit,
written whole; a second call goes on where the first one ended. ``--next`` identifies again, with
the record of the proposed test beside the first one.
"""

from __future__ import annotations

import argparse
import json
import time
import traceback
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from benchmarks.blind_panel.guard import lock
from benchmarks.blind_panel.layout import RESULTS, SEALED, TESTS, add_common, part_of
from benchmarks.blind_panel.tasks import Task, read_tasks, share
from ema_cli.console import track
from ema_record.errors import EmaError
from ema_record.files import new_file


def identify_unit(task: Task, folder: Path, tests: tuple[str, ...]) -> dict[str, Any]:
    """Return the JSON object of one unit: what `identify` says, and how long it took."""
    from ema_identification.identify import identify
    from ema_record.bag.read import read_bag
    from ema_sim.model_file import load_model_file

    measured = [read_bag(folder / test) for test in tests]
    validate = [read_bag(folder / "validate")]
    start = time.perf_counter()
    try:
        found = identify(measured, load_model_file(None), validate=validate,
                         without=task.without)
    except EmaError as error:
        return _failed(str(error), start)
    except Exception:  # noqa: BLE001  (a crash is a result of the panel)
        return _failed(traceback.format_exc(), start)
    profile = found.next_profile
    return {
        **found.to_dict(), "seconds": time.perf_counter() - start, "error": "",
        "next_profile": None if profile is None else profile.model_dump(mode="json"),
        "model_text": found.model_text,
    }


def _failed(error: str, start: float) -> dict[str, Any]:
    return {"verdict": "error", "findings": [], "unknown": None, "next_profile": None,
            "gap_before": None, "gap_after": None, "noise_floor": None, "recalibrated": [],
            "seconds": time.perf_counter() - start, "error": error}


def _run(task: Task, out: Path, again: bool) -> str:
    lock(out / SEALED)
    tests = ("measured", "next") if again else ("measured",)
    with threadpool_limits(limits=1):
        result = identify_unit(task, out / TESTS / task.id, tests)
    with new_file(result_path(out, task.id, again=again)) as path:
        path.write_text(json.dumps(result, allow_nan=True), encoding="utf-8")
    return str(result["verdict"])


def result_path(out: Path, record: str, *, again: bool = False) -> Path:
    """Return where the result of a unit lies."""
    return out / RESULTS / (f"{record}.next.json" if again else f"{record}.json")


def main() -> None:
    """Read the command line and run."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_common(parser)
    parser.add_argument("--next", action="store_true", help="with the proposed test")
    parser.add_argument("--records", nargs="*", default=[], help="only these units")
    given = parser.parse_args()
    lock(given.out / SEALED)
    (given.out / RESULTS).mkdir(exist_ok=True)
    tasks = share(read_tasks(given.out), part_of(given.part))
    if given.records:
        tasks = [task for task in tasks if task.id in given.records]
    last = "next" if given.next else "validate"
    ready = [t for t in tasks if (given.out / TESTS / t.id / last).exists()]
    todo = [t for t in ready if not result_path(given.out, t.id, again=given.next).exists()]
    done = Parallel(n_jobs=given.workers, return_as="generator")(
        delayed(_run)(task, given.out, given.next) for task in todo)
    for _ in track(done, "units", len(todo)):
        pass
    absent = "" if given.next else f", {len(tasks) - len(ready)} have no bags yet"
    print(f"part {given.part}: {len(todo)} units identified, {len(ready) - len(todo)} were done "
          f"before{absent}")


if __name__ == "__main__":
    main()
