"""Consecutive built-in tests, a random fault of the live system in each.

What must hold after each is in `support.live_faults`, and the next test runs. At the end: no
process and no shared memory is left.
"""

from __future__ import annotations

import json
import os
import tempfile
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import psutil

from benchmarks.ledger import Ledger, Row
from support.chain import Clock, chain, left_in_shared_memory
from support.live_faults import HIDDEN, KINDS, one

CHUNK = 10
"""Tests on one set of nodes."""


def chunk(numbers: list[int], seed: int) -> list[dict[str, Any]]:
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
                    kind = KINDS[rng.choice(sorted(KINDS))]
                    results.append({"number": number, **one(found, kind, rng)})
                    print(json.dumps(results[-1]), flush=True)
        finally:
            for variable in clock.environment:
                os.environ.pop(variable, None)
        orphans = [pid for pid in found.pids if psutil.pid_exists(pid)]
        results[-1]["orphans"] = len(orphans)
        results[-1]["shared_memory"] = len(left_in_shared_memory() - litter)
    return results


def measure(ledger: Ledger, seed: int, *, tests: int) -> list[Row]:
    """Run `tests` built-in tests; print a line a test."""
    results: list[dict[str, Any]] = []
    for first in range(0, tests, CHUNK):
        numbers = list(range(first, min(first + CHUNK, tests)))
        results += ledger.run(f"{seed} {numbers}", partial(chunk, numbers, seed))
    sums = {
        "hangs": sum("hang" in str(r["wrong"]) for r in results),
        "orphans": sum(r.get("orphans", 0) for r in results),
        "wrong healthy": sum(r["verdict"] == "healthy" for r in results),
        "otherwise wrong": sum(bool(r["wrong"]) for r in results),
        "files in shared memory": sum(r.get("shared_memory", 0) for r in results),
    }
    return [Row(
        f"{len(results)} consecutive tests with a random live fault each",
        "0 hangs, 0 orphans, 0 wrong \"healthy\"",
        ", ".join(f"{count} {name}" for name, count in sums.items()), not any(sums.values()),
    )]
