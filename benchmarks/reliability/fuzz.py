"""Fuzzed input of everything that reads what others wrote: only our own errors, no hang.

Each chunk of inputs runs in a process of its own, whose largest resident memory is its result too.
"""

from __future__ import annotations

import json
from functools import partial

from benchmarks.ledger import Ledger, Row
from support.fuzz import MEMORY, in_fresh_process

CHUNK = 1000


def measure(ledger: Ledger, seed: int, *, inputs: int) -> list[Row]:
    """Share `inputs` among all readers; print what failed."""
    tables = []
    for first in range(0, inputs, CHUNK):
        size, number = min(CHUNK, inputs - first), seed * 1000 + first // CHUNK
        tables += ledger.run(f"{number} {size}", partial(in_fresh_process, size, number))
    for table in tables:
        for failure in table["failures"]:
            print(json.dumps({"target": table["target"], "failure": failure}), flush=True)
    given, uncaught, hangs = (
        sum(t[key] for t in tables) for key in ("inputs", "uncaught", "hangs"))
    slowest, memory = (max(t[key] for t in tables) for key in ("slowest_s", "peak_MiB"))
    return [Row(
        f"{given} fuzzed inputs of {len({t['target'] for t in tables})} readers",
        f"0 uncaught, 0 hangs > 5 s, <= {MEMORY} MiB",
        f"{uncaught} uncaught, {hangs} hangs (slowest {slowest} s), {memory} MiB",
        uncaught == 0 == hangs and memory <= MEMORY,
    )]
