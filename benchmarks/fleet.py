"""Fleet: bags judged a second, cold and remembered, how that grows, and the memory it takes.

Run from the checkout: ``python -m benchmarks.fleet`` (``--cold N``, ``--cached N`` for smaller
ones, ``--jobs``). Cold: N bags of the profile are judged, in four steps, each in a process of its
own; bags are copies of an example bag with serial numbers and times of their own. Cached: N
bags are told by the store; their messages are links to one file, their contents differ in the
metadata, and what is kept of each is the first bag's verdict with a number and a time of its own.
Exit status 1 if a limit is missed.
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
STEPS = 4
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
    """Return the runs over a growing fleet, nothing remembered."""
    record = ema.read(EXAMPLES / f"sim_0000_{profile}")
    found, made = [], 0
    for step in range(1, STEPS + 1):
        for made in range(made, count * step // STEPS):  # noqa: B020  (goes on from there)
            known = replace(record.provenance, serial_number=f"SN-{made % 20:04d}",
                            start_time=(made + 1) * DAY)
            ema.write(replace(record, provenance=known), folder / "fleet" / f"f{made:05d}")
        made = count * step // STEPS
        found.append((made, measured(folder / "fleet", folder / f"cache{step}", jobs)))
    return found


def cached(count: int, bag: Path, folder: Path) -> Run:
    """Return the run over a fleet that the store knows."""
    cache = folder / "cache"
    said = ema.to_json(bag)
    settings = JudgeSettings.of(None, None)
    with VerdictStore(settings.key(), cache / FOLDER) as store:
        objects = []
        for k in range(count):
            own = folder / "many" / f"SN-{k % UNITS:04d}" / f"f{k:05d}"
            own.mkdir(parents=True)
            for path in bag.iterdir():
                if path.suffix == ".yaml":
                    shutil.copy(path, own)
                    with (own / path.name).open("a") as file:
                        file.write(f"# {k}\n")
                else:
                    (own / path.name).hardlink_to(path)
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
    (few, first), (many, last) = grown[0], grown[-1]
    more = (many - few) / (last.cpu - first.cpu)
    for count, run in grown:
        print(f"cold, {count:6d} bags ({options.profile}): {run.wall:8.1f} s, "
              f"{count / run.wall:6.2f} bags/s on {options.jobs} jobs, {count / run.cpu:6.2f} a "
              f"second of CPU, {run.memory:.0f} MB a process")
    print(f"each further bag: {1.0 / more:.3f} s of CPU, {more:.2f} bags a second and core  "
          f"(limit {LEAST_RATE:g})")
    print(f"remembered, {options.cached} bags: {told.wall:.2f} s, CPU {told.cpu:.2f} s, "
          f"{told.memory:.0f} MB  (limit {MOST_CACHED:g} s for 10,000)")
    print(f"load average at the begin {load:.1f} on {os.cpu_count()} cores")
    if options.json:
        print(json.dumps({"bags_a_core_second": more, "cached_s": told.wall, "load": load}))
    return 0 if more >= LEAST_RATE and told.wall <= MOST_CACHED else 1


if __name__ == "__main__":
    sys.exit(main())
