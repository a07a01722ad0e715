"""Reliability with one command, and the table of its targets.

Run: python -m benchmarks.reliability [PART ...] [--quick] [--seed 6] [--results DIR]

Results are kept below ``--results``, so that what is done is not done again; another seed or
size is another result. Exit status 1 if a target is missed.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from benchmarks.ledger import Ledger


class Sizes(NamedTuple):
    """Arguments of a part's `measure`."""

    quick: dict[str, float]
    whole: dict[str, float]


PARTS = {
    "kills": Sizes({"kills": 20, "others": 6}, {"kills": 200, "others": 20}),
    "damage": Sizes({"flips": 100, "cuts": 20}, {"flips": 1000, "cuts": 200}),
    "lint": Sizes({"bags": 2, "good_bags": 20}, {"bags": 20, "good_bags": 200}),
    "fuzz": Sizes({"inputs": 500}, {"inputs": 10_000}),
    "determinism": Sizes({"repeats": 8}, {"repeats": 100}),
    "live_faults": Sizes({"tests": 10}, {"tests": 100}),
    "soak": Sizes({"minutes": 1}, {"minutes": 30}),
}
"""Modules of this package."""


def main() -> int:
    """Run the parts, each in a process of its own, and print the table."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}")
    options.add_argument("--quick", action="store_true", help="a tenth or less, some 5 minutes")
    options.add_argument("--seed", type=int, default=6)
    options.add_argument("--results", type=Path, default=Path("reliability_results"))
    arguments = options.parse_args()
    if unknown := set(arguments.parts) - set(PARTS):
        options.error(f"no part {', '.join(sorted(unknown))}: choose of {', '.join(PARTS)}")
    table = Table("what", "target", "found", "", title=f"reliability, seed {arguments.seed}")
    good = True
    for name in arguments.parts or PARTS:
        begin = time.monotonic()
        sizes = PARTS[name].quick if arguments.quick else PARTS[name].whole
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            rows = pool.submit(
                import_module(f"benchmarks.reliability.{name}").measure,
                Ledger(arguments.results / f"{name}.jsonl"), arguments.seed, **sizes,
            ).result()
        print(f"{name}: {time.monotonic() - begin:.0f} s", flush=True)
        for row in rows:
            good &= row.good
            table.add_row(row.what, row.target, row.found, "met" if row.good else "MISSED")
    Console().print(table)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
