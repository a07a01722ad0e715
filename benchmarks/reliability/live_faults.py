"""Consecutive built-in tests, a random fault of the live system in each.

What must hold after each is in `support.live_faults`, and the next test runs. At the end: no
process and no shared memory is left.

Run: python -m benchmarks.reliability.live_faults [--tests 100] [--seed 6] [--results FILE]
     [--only KIND]
"""

from __future__ import annotations

import json
import os
import tempfile
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

import psutil

from benchmarks.ledger import Ledger, options_of
from support.chain import Clock, chain, left_in_shared_memory
from support.live_faults import HIDDEN, KINDS, one

CHUNK = 10
"""Tests on one set of nodes."""


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
