"""Fuzzed input of everything that reads what others wrote: only our own errors, no hang.

The targets and their inputs are in `fuzz_targets` and `fuzz_imports`. Each chunk of inputs runs in
a process of its own, whose largest resident memory is its result too.

Run: python -m benchmarks.reliability.fuzz [--inputs 10000] [--seed 6] [--results FILE]
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
import warnings
from functools import partial
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings

from benchmarks.reliability.fuzz_imports import import_targets
from benchmarks.reliability.fuzz_targets import Target, make_targets
from benchmarks.reliability.ledger import Ledger, options_of
from ema_record.errors import EmaError

HANG = 5.0
"""Longest time for one input (s)."""
MEMORY = 512
"""Largest resident memory of the process (MiB)."""
CHUNK = 1000
CHUNK_TIMEOUT = 900.0


def fuzz(target: Target, inputs: int, number: int) -> dict[str, Any]:
    """Give a target its inputs; return what came of them."""
    table = {"inputs": 0, "accepted": 0, "refused": 0, "uncaught": 0, "hangs": 0,
             "slowest_s": 0.0}
    failures: list[str] = []

    @seed(number)
    @settings(max_examples=inputs, database=None, deadline=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))
    @given(target.inputs)
    def run(value: Any) -> None:
        begin = time.perf_counter()
        table["inputs"] += 1
        try:
            target.read(value)
            table["accepted"] += 1
        except EmaError as error:
            table["refused"] += 1
            if "\n" in str(error):
                failures.append(f"several lines: {error!r}")
        except Exception as error:  # noqa: BLE001  (any other one is what is looked for)
            table["uncaught"] += 1
            failures.append(f"{type(error).__name__}: {str(error)[:100]} on {value!r:.300}")
        took = time.perf_counter() - begin
        table["slowest_s"] = max(table["slowest_s"], round(took, 3))
        table["hangs"] += took > HANG

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run()
    return {**table, "failures": failures[:10]}


def all_targets(folder: Path) -> list[Target]:
    """Return every target; `folder` is theirs."""
    return [*make_targets(folder), *import_targets(folder)]


def chunk(inputs: int, number: int) -> list[dict[str, Any]]:
    """Give all targets their share of `inputs`; return a table each."""
    with tempfile.TemporaryDirectory() as name:
        targets = all_targets(Path(name))
        total = sum(target.share for target in targets)
        return [
            {"target": target.name, **fuzz(target, round(inputs * target.share / total), number),
             "peak_MiB": peak()}
            for target in targets
        ]


def in_fresh_process(inputs: int, number: int) -> list[dict[str, Any]]:
    """Return the tables of one chunk, done in a process of its own."""
    run = subprocess.run(
        [sys.executable, "-m", "benchmarks.reliability.fuzz", "--inputs", str(inputs),
         "--seed", str(number), "--here"],
        check=True, stdout=subprocess.PIPE, timeout=CHUNK_TIMEOUT,
    )
    tables: list[dict[str, Any]] = json.loads(run.stdout)
    return tables


def main() -> None:
    """Print what failed, and the sums."""
    options = options_of(__doc__)
    options.add_argument("--inputs", type=int, default=10_000)
    options.add_argument("--here", action="store_true", help="one chunk, in this process")
    arguments = options.parse_args()
    if arguments.here:
        print(json.dumps(chunk(arguments.inputs, arguments.seed)))
        return
    ledger = Ledger(arguments.results)
    sums = {"inputs": 0, "accepted": 0, "refused": 0, "uncaught": 0, "hangs": 0}
    worst, slowest = 0, 0.0
    for first in range(0, arguments.inputs, CHUNK):
        size = min(CHUNK, arguments.inputs - first)
        number = arguments.seed * 1000 + first // CHUNK
        tables = ledger.run(f"{number} {size}", partial(in_fresh_process, size, number))
        for table in tables:
            for key in sums:
                sums[key] += table[key]
            worst = max(worst, table["peak_MiB"])
            slowest = max(slowest, table["slowest_s"])
            for failure in table["failures"]:
                print(json.dumps({"target": table["target"], "failure": failure}), flush=True)
    print(json.dumps({"seed": arguments.seed, "targets": len(tables), **sums,
                      "slowest_s": slowest, "peak_MiB": worst, "bound_MiB": MEMORY}))


def peak() -> int:
    """Return the largest resident memory of this process so far (MiB).

    Not `getrusage`: its maximum survives `exec`, so a child of a large process starts with it.
    """
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.partition("VmHWM:")[2].split()[0]) // 1024


if __name__ == "__main__":
    main()
