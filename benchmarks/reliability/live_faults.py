"""Consecutive built-in tests, a random fault of the live system in each.

The actuator has a turn short throughout, so "healthy" is always wrong. After each fault: the
request is answered within a stated time, `/diagnostics` says why, the record is whole or marked
or known to be cut, its samples are those of one run, the verdict that follows is right, and the
next test runs. At the end: no process and no shared memory is left.

Run: python -m benchmarks.reliability.live_faults [--tests 100] [--seed 6] [--results FILE]
     [--only KIND]
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

import psutil

from benchmarks.reliability.chain import (
    ACTUATOR_STATUS,
    MONITOR_STATUS,
    Chain,
    Clock,
    TimedOutError,
    chain,
    left_in_shared_memory,
)
from benchmarks.reliability.ledger import Ledger, options_of
from benchmarks.reliability.live_kinds import KINDS, Kind
from ema_cli.commands.bit import PROGNOSTICS
from ema_record.bag.read import read_bag
from ema_record.checks import guard_findings
from ema_record.errors import IncompleteRecordError, RecordError

HIDDEN = {"turn_short.fraction": 0.1, "turn_short.phase": "b"}
SAMPLES_OF_A_TEST = 62_600
VERDICT_LIMIT = 30.0
CHUNK = 10
"""Tests on one set of nodes."""


def records(folder: Path) -> set[Path]:
    """Return the bags in a folder."""
    return {path for path in folder.iterdir() if path.is_dir()}


def judge_record(path: Path) -> str:
    """Return how a bag ended: complete, aborted, interrupted or cut; or what is wrong in it."""
    try:
        record = read_bag(path)
    except IncompleteRecordError:
        return "cut"
    except RecordError as error:
        return f"WRONG {error}"
    status = record.provenance.status
    wrong = [f.rule for f in guard_findings(record)
             if f.rule not in ("test_not_complete", "record_length")]
    if wrong or (status == "complete" and len(record) != SAMPLES_OF_A_TEST):
        return f"WRONG {status}, {len(record)} samples, {wrong}"
    return status


def verdict_on(found: Chain, record: str) -> dict[str, Any]:
    """Return the verdict on a record, starting the prognostics where it was killed."""
    if not found.runs(PROGNOSTICS):
        found.start(PROGNOSTICS)
    found.wait(
        lambda: found.node.verdict is not None and found.node.verdict["bag"] == record,
        VERDICT_LIMIT, "the verdict",
    )
    assert found.node.verdict is not None
    return found.node.verdict


def one(found: Chain, kind: Kind, rng: Random) -> dict[str, Any]:
    """Run one test with one fault; return what came of it, "wrong" empty where all is well."""
    found.ready()
    found.stay(0.5)
    before = records(found.out)
    fault = kind.make(found, rng)
    begin = time.monotonic()
    wrong: list[str] = []
    answer = verdict = None
    try:
        answer = found.run_test(fault.act, kind.limit, fault.lost)
        took = time.monotonic() - begin
        fault.end()
        found.ready()
        if answer is not None and answer["status"] == "complete":
            verdict = verdict_on(found, answer["record"])
        found.wait(lambda: found.status.get(ACTUATOR_STATUS, ("", {}))[1].get("state") == "idle"
                   and found.stage() == "idle", 15.0, "the actuator at rest")
    except TimedOutError as error:
        took = time.monotonic() - begin
        wrong.append(f"hang: {error}")
        fault.end()
    ended = answer["status"] if answer is not None else "no answer"
    expected = kind.ends if fault.done else (*kind.ends, "complete")
    if not wrong and ended not in expected:
        said = answer["message"] if answer is not None else "nothing"
        wrong.append(f"ended {ended} ({said}), expected one of {', '.join(expected)}")
    if verdict is not None and (verdict["verdict"], verdict["fault_class"]) != (
        "fault", "turn_short"
    ):
        wrong.append(f"verdict {verdict['verdict']} {verdict['reasons'][:1]}")
    new = [judge_record(path) for path in sorted(records(found.out) - before)]
    wrong += [text for text in new if text.startswith("WRONG")]
    wrong += fault.wrong()
    said = found.status.get(MONITOR_STATUS, ("", {}))[0]
    if ended in ("aborted", "refused") and "abort" not in said and "refused" not in said:
        wrong.append(f"/diagnostics says only {said!r}")
    return {"kind": kind.name, "ended": ended, "took": round(took, 2), "records": new,
            "message": answer["message"] if answer else "",
            "verdict": verdict["verdict"] if verdict else None, "wrong": wrong}


def chunk(numbers: list[int], seed: int, only: str | None) -> list[dict[str, Any]]:
    """Run some tests on one set of nodes; look for what they leave behind."""
    results = []
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        clock = Clock(out)
        os.environ |= clock.environment
        try:
            with chain(out, simulator={**HIDDEN, "serial_number": "EMA-1"}) as found:
                found.clock = clock
                litter = left_in_shared_memory()
                for number in numbers:
                    rng = Random(f"live {seed} {number}")
                    kind = KINDS[only or rng.choice(sorted(KINDS))]
                    results.append({"number": number, **one(found, kind, rng)})
                    print(json.dumps(results[-1]), flush=True)
        finally:
            for variable in clock.environment:
                os.environ.pop(variable, None)
        orphans = [pid for pid in found.pids if psutil.pid_exists(pid)]
        results[-1]["orphans"] = len(orphans)
        results[-1]["shared_memory"] = len(left_in_shared_memory() - litter)
    return results


def main() -> None:
    """Print a line a test, and the table."""
    options = options_of(__doc__)
    options.add_argument("--tests", type=int, default=100)
    options.add_argument("--only", choices=sorted(KINDS), default=None)
    arguments = options.parse_args()
    ledger = Ledger(arguments.results)
    results: list[dict[str, Any]] = []
    for first in range(0, arguments.tests, CHUNK):
        numbers = list(range(first, min(first + CHUNK, arguments.tests)))
        results += ledger.run(
            f"{arguments.seed} {arguments.only} {numbers}",
            lambda: chunk(numbers, arguments.seed, arguments.only),  # noqa: B023
        )
    took: dict[str, float] = {}
    for r in results:
        took[r["kind"]] = max(took.get(r["kind"], 0.0), r["took"])
    print(json.dumps({
        "seed": arguments.seed, "tests": len(results),
        "kinds": Counter(r["kind"] for r in results),
        "longest_s": took, "hangs": sum("hang" in str(r["wrong"]) for r in results),
        "wrong": sum(bool(r["wrong"]) for r in results),
        "wrong_healthy": sum(r["verdict"] == "healthy" for r in results),
        "orphans": sum(r.get("orphans", 0) for r in results),
        "shared_memory": sum(r.get("shared_memory", 0) for r in results),
    }))


if __name__ == "__main__":
    main()
