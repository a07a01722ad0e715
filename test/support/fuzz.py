"""Fuzzed input of everything that reads what others wrote: only our own errors, no hang.

The targets and their inputs are in `fuzz_targets` and `fuzz_imports`.
"""

from __future__ import annotations

import multiprocessing
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings

from ema_record.errors import EmaError
from support.fuzz_imports import import_targets
from support.fuzz_targets import Target, make_targets

HANG = 5.0
"""Longest time for one input (s)."""
MEMORY = 512
"""Largest resident memory of the process (MiB)."""
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
    """Return the tables of one chunk, done in a process of its own, which is ended if it hangs."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply_async(chunk, (inputs, number)).get(CHUNK_TIMEOUT)


def peak() -> int:
    """Return the largest resident memory of this process so far (MiB).

    Not `getrusage`: its maximum survives `exec`, so a child of a large process starts with it.
    """
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.partition("VmHWM:")[2].split()[0]) // 1024
