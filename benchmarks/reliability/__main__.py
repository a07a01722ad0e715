"""All reliability benchmarks with one command, and the table of their targets.

Each part is also a command of its own, see `docs/recovery.md`. Results are kept below
``--results``, so that what is done is not done again; another seed or size is another result.

Run: python -m benchmarks.reliability [--quick] [--only PART ...] [--skip PART ...] [--seed 6]
     [--results DIR]
Exit status 1 if a target is missed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table


class Row(NamedTuple):
    """One line of the table."""

    what: str
    target: str
    found: str
    good: bool


class Part(NamedTuple):
    """One benchmark: its sizes and what its result says."""

    quick: tuple[str, ...]
    whole: tuple[str, ...]
    rows: Callable[[dict[str, Any]], list[Row]]


def _kills(r: dict[str, Any]) -> list[Row]:
    rows = []
    for kind, words in (("kill", "SIGKILLs while recording"), ("full disk", "disks that fill up"),
                        ("removed directory", "directories removed while recording")):
        t = r[kind]
        struck = t["struck"] - t["finished"]
        rows.append(Row(
            f"{t['struck']} {words}", "<= 100 ms lost each, all recoverable, 0 called complete",
            f"{t['lost_ms_max']:.0f} ms at most, {t['recovered']} of {struck} recovered "
            f"({t['finished']} whole), {t['called_complete']} called complete",
            t["over_target"] == 0 == t["called_complete"] and t["recovered"] == struck,
        ))
    return rows


def _damage(r: dict[str, Any]) -> list[Row]:
    return [
        Row(f"{sum(r[kind].values())} {words}", "0 silently different verdicts",
            f"{r[f'{kind}_silently_different']} ({r[kind]})", r[f"{kind}_silently_different"] == 0)
        for kind, words in (("flips", "single-bit flips"), ("cuts", "truncations"))
    ]


def _lint(r: dict[str, Any]) -> list[Row]:
    return [
        Row(f"{r['kinds']} kinds of defects x {r['defects'] // max(r['kinds'], 1)} bags",
            ">= 99 % found", f"{r['found']} of {r['defects']} ({r['share']:.2%})",
            r["share"] >= 0.99),
        Row(f"{r['good_bags']} good bags", "0 findings",
            f"{r['good_bags_with_findings']} with findings, {r['good_bags_without_verdict']} kept "
            "from a verdict",
            r["good_bags_with_findings"] == 0 == r["good_bags_without_verdict"]),
    ]


def _fuzz(r: dict[str, Any]) -> list[Row]:
    return [Row(
        f"{r['inputs']} fuzzed inputs of {r['targets']} readers",
        "0 uncaught, 0 hangs > 5 s, <= 512 MiB",
        f"{r['uncaught']} uncaught, {r['hangs']} hangs (slowest {r['slowest_s']} s), "
        f"{r['peak_MiB']} MiB",
        r["uncaught"] == 0 == r["hangs"] and r["peak_MiB"] <= r["bound_MiB"],
    )]


def _determinism(r: dict[str, Any]) -> list[Row]:
    return [Row(f"{r['repeats']} repeats of one verdict across paths, rates and workers",
                "1 distinct output", str(r["distinct"]), r["distinct"] == 1)]


def _live(r: dict[str, Any]) -> list[Row]:
    return [Row(
        f"{r['tests']} consecutive tests with a random live fault each",
        "0 hangs, 0 orphans, 0 wrong \"healthy\"",
        f"{r['hangs']} hangs, {r['orphans']} orphans, {r['wrong_healthy']} wrong healthy, "
        f"{r['wrong']} otherwise wrong, {r['shared_memory']} files in shared memory",
        not any(r[k] for k in ("hangs", "orphans", "wrong_healthy", "wrong", "shared_memory")),
    )]


def _soak(r: dict[str, Any]) -> list[Row]:
    growth = ", ".join(f"{name} {100 * m['growth']:+.1f} %" for name, m in r["memory"].items())
    return [Row(f"{r['minutes']} minutes of continuous tests ({r['tests']})",
                "memory flat within 5 %, 0 samples lost",
                f"{growth}; {r['lost']} of {r['samples_published']} lost",
                bool(r["flat"]) and r["lost"] == 0 and r["passed"] == r["tests"])]


PARTS: dict[str, Part] = {
    "kills": Part(("--kills", "20", "--others", "6"), ("--kills", "200", "--others", "20"),
                  _kills),
    "damage": Part(("--flips", "100", "--cuts", "20"), ("--flips", "1000", "--cuts", "200"),
                   _damage),
    "lint": Part(("--bags", "2", "--good", "20"), ("--bags", "20", "--good", "200"), _lint),
    "fuzz": Part(("--inputs", "500"), ("--inputs", "10000"), _fuzz),
    "determinism": Part(("--repeats", "8"), ("--repeats", "100"), _determinism),
    "live_faults": Part(("--tests", "10"), ("--tests", "100"), _live),
    "soak": Part(("--minutes", "1"), ("--minutes", "30"), _soak),
}


def run(name: str, sizes: tuple[str, ...], seed: int, results: Path) -> dict[str, Any]:
    """Run one part and return its table, the last line that it prints."""
    command = [sys.executable, "-m", f"benchmarks.reliability.{name}", *sizes,
               "--seed", str(seed), "--results", str(results / f"{name}.jsonl")]
    process = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    *others, last = process.stdout.splitlines()
    for line in others:
        print(line[:400], flush=True)
    table: dict[str, Any] = json.loads(last)
    return table


def main() -> int:
    """Run the parts and print the table."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--quick", action="store_true", help="a tenth or less, some 5 minutes")
    options.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    options.add_argument("--skip", nargs="+", choices=PARTS, default=[])
    options.add_argument("--seed", type=int, default=6)
    options.add_argument("--results", type=Path, default=Path("reliability_results"))
    arguments = options.parse_args()
    table = Table("what", "target", "found", "", title=f"reliability, seed {arguments.seed}")
    good = True
    for name in arguments.only:
        if name in arguments.skip:
            continue
        part = PARTS[name]
        begin = time.monotonic()
        sizes = part.quick if arguments.quick else part.whole
        found = run(name, sizes, arguments.seed, arguments.results)
        print(f"{name}: {time.monotonic() - begin:.0f} s", flush=True)
        for row in part.rows(found):
            good &= row.good
            table.add_row(row.what, row.target, row.found, "met" if row.good else "MISSED")
    Console().print(table)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
