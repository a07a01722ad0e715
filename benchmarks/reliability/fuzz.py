"""Fuzzed input of everything that reads what others wrote: only our own errors, no hang.

Each chunk of inputs runs in a process of its own, whose largest resident memory is its result too.

Run: python -m benchmarks.reliability.fuzz [--inputs 10000] [--seed 6] [--results FILE]
"""

from __future__ import annotations

import json
from functools import partial

from benchmarks.ledger import Ledger, options_of
from support.fuzz import MEMORY, in_fresh_process

CHUNK = 1000


def main() -> None:
    """Print what failed, and the sums."""
    options = options_of(__doc__)
    options.add_argument("--inputs", type=int, default=10_000)
    arguments = options.parse_args()
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


if __name__ == "__main__":
    main()
