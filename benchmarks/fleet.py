"""Fleet: bags judged a second, cold and remembered, how that grows, and the memory it takes.

Run from the checkout: ``python -m benchmarks.fleet`` (``--cold N``, ``--cached N`` for smaller
ones, ``--jobs``). Cold: a fleet of N bags of the profile grows in eight equal steps; at each, in a
process of its own, the command judges the bags that are new and is told the others by the store.
Contents differ in the metadata of the bag, the messages are links to those of a few records with
serial numbers and times of their own (N whole ones would take 2 MB each). Cached: N bags are
told by the store; what is kept of each is the first bag's verdict with a number and a time of
its own. Rates are told by the wall and, as other work may share the cores, by the CPU. Exit
status 1 if a limit is missed, the cold one by the CPU.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import ema_phm as ema
from ema_prognostics.fleet.judging import JudgeSettings
from ema_prognostics.fleet.verdict_store import TICK, VerdictStore
from ema_record.array_cache import FOLDER

LEAST_RATE = 6.0
"""Bags a second and core, cold."""
MOST_CACHED = 5.0
"""For 10,000 bags that are remembered (s)."""
STEPS = 8
RECORDS = 40
"""Records that the messages of the cold fleet are links to."""
UNITS = 200
"""Units of the cached fleet."""
EXAMPLES = Path(__file__).resolve().parents[1] / "bags"
DAY = 86_400_000_000_000


class Run(NamedTuple):
    """One process of ``ema fleet``."""

    wall: float
    cpu: float
    memory: float
    """Largest of a process, itself or a worker (MB)."""


def measured(fleet: Path, cache: Path, jobs: int) -> Run:
    """Run the command and return what it took (s, s, MB)."""
    code = ("import resource, sys; from ema_cli.main import run; run(sys.argv[1:]);"
            "print(max(resource.getrusage(w).ru_maxrss for w in"
            "(resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))")
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    out = subprocess.run(
        [sys.executable, "-c", code, "fleet", str(fleet), "--jobs", str(jobs)],
        check=True, capture_output=True, text=True,
        env={**os.environ, "XDG_CACHE_HOME": str(cache)}).stdout.splitlines()
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"    {out[-2]}", flush=True)
    return Run(wall, cpu, int(out[-1]) / 1024.0)


def cold(count: int, profile: str, folder: Path, jobs: int) -> list[tuple[int, Run]]:
    """Return how many bags were new at each step of a growing fleet, and the run that followed."""
    record = ema.read(EXAMPLES / f"sim_0000_{profile}")
    few = min(RECORDS, count)
    for k in range(few):
        known = replace(record.provenance, serial_number=f"SN-{k % 20:04d}",
                        start_time=(k + 1) * DAY)
        ema.write(replace(record, provenance=known), folder / "records" / f"r{k:02d}")
    found, made = [], 0
    for step in range(1, STEPS + 1):
        before, made = made, count * step // STEPS
        for k in range(before, made):
            _linked(folder / "records" / f"r{k % few:02d}", folder / "fleet" / f"f{k:05d}", k)
        run = measured(folder / "fleet", folder / "cache", jobs)
        found.append((made - before, run))
        print(f"cold, {made - before} more bags of {made} ({profile}): {run.wall:.1f} s, "
              f"{(made - before) / run.wall:.2f} bags/s by the wall on {jobs} jobs; "
              f"{run.cpu:.1f} s of CPU, {(made - before) / run.cpu:.2f} bags a second of CPU; "
              f"{run.memory:.0f} MB a process", flush=True)
    return found


def _linked(bag: Path, own: Path, number: int) -> None:
    """Make a bag of the same messages whose metadata, and with them its hash, are its own."""
    own.mkdir(parents=True)
    for path in bag.iterdir():
        if path.suffix == ".yaml":
            shutil.copy(path, own)
            with (own / path.name).open("a") as file:
                file.write(f"# {number}\n")
        else:
            (own / path.name).hardlink_to(path)


def cached(count: int, bag: Path, folder: Path) -> Run:
    """Return the run over a fleet that the store knows."""
    cache = folder / "known"
    said = ema.to_json(bag)
    settings = JudgeSettings.of(None, None)
    with VerdictStore(settings.key(), cache / FOLDER) as store:
        objects = []
        for k in range(count):
            own = folder / "many" / f"SN-{k % UNITS:04d}" / f"f{k:05d}"
            _linked(bag, own, k)
            start = (k + 1) * DAY // 10
            objects.append((own, said | {"serial_number": f"SN-{k % UNITS:04d}",
                                         "start_time": start, "bag": str(own)}))
        time.sleep(TICK / 1e9 + 0.5)
        begin = time.perf_counter()
        store.put((store.sha256(own) or "", one | {"record_sha256": store.sha256(own)})
                  for own, one in objects)
        print(f"    contents of {count} bags hashed in {time.perf_counter() - begin:.1f} s")
    return measured(folder / "many", cache, 1)


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--cold", type=int, default=10_000)
    parser.add_argument("--cached", type=int, default=10_000)
    parser.add_argument("--profile", default="extended", choices=("extended", "step"))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--json", action="store_true", help="the numbers as one JSON object")
    options = parser.parse_args()
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(dir=".") as name:
        folder = Path(name)
        grown = cold(options.cold, options.profile, folder, options.jobs)
        told = cached(options.cached, folder / "fleet" / "f00000", folder)
    rates = [new / run.cpu for new, run in grown]
    print(f"bags a second of CPU, step by step: {', '.join(f'{r:.2f}' for r in rates)} "
          f"(limit {LEAST_RATE:g} a core)")
    print(f"remembered, {options.cached} bags: {told.wall:.2f} s, CPU {told.cpu:.2f} s, "
          f"{told.memory:.0f} MB  (limit {MOST_CACHED:g} s for 10,000)")
    print(f"load average {load:.1f} at the begin, {os.getloadavg()[0]:.1f} at the end, on "
          f"{os.cpu_count()} cores")
    if options.json:
        print(json.dumps({"bags_a_core_second": min(rates), "cached_s": told.wall, "load": load}))
    return 0 if min(rates) >= LEAST_RATE and told.wall <= MOST_CACHED else 1


if __name__ == "__main__":
    sys.exit(main())
