"""Time of a campaign of the step profile, against its limits; equal results of 1 and 2 workers.

Run from the checkout: ``python -m benchmarks.campaign`` (``--runs N`` for a shorter one).

The campaign is a training set as one would make it: resistance, friction, noise and a turn
short of any phase vary, the summary is kept on disk. Every number is a wall time, start of
the workers and all files included. Exit status 1 if a limit is missed.
"""

from __future__ import annotations

import argparse
import filecmp
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

from ema_sim.campaign.plan import CampaignPlan, plan_from
from ema_sim.campaign.run import run_campaign

FULL = 5_000
LIMIT, AIM = 90.0, 45.0
"""For `FULL` runs on 2 cores (s)."""
EQUAL_RUNS = 400


def training_plan(runs: int) -> CampaignPlan:
    """Return the plan that is timed."""
    return plan_from(
        {
            "name": "benchmark", "profile": "step", "seed": 1, "runs": runs,
            "parameters": {
                "actuator.motor.phase_resistance": {"normal": [1.0, 0.03], "relative": True},
                "actuator.motor.dynamic_friction": {"uniform": [0.9, 1.1], "relative": True},
                "turn_short.fraction": {"log_uniform": [0.002, 0.2]},
                "turn_short.phase": {"choice": ["a", "b", "c"]},
                "noise": {"uniform": [0.5, 2.0]},
            },
        },
        "benchmark",
    )


def wall_time(runs: int, jobs: int, out: Path) -> float:
    """Return how long a campaign takes (s)."""
    begin = time.perf_counter()
    run_campaign(training_plan(runs), jobs=jobs, out=out)
    return time.perf_counter() - begin


def same_files(one: Path, other: Path) -> bool:
    """Whether two folders hold the same bytes."""
    files = [sorted(p.relative_to(f) for p in f.rglob("*") if p.is_file()) for f in (one, other)]
    return files[0] == files[1] and filecmp.cmpfiles(
        one, other, [str(p) for p in files[0]], shallow=False
    )[1:] == ([], [])


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=FULL)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=1)
    options = parser.parse_args()
    scale = options.runs / FULL
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        run_campaign(training_plan(1), jobs=1)  # the kernel is in the cache
        load = os.getloadavg()[0]
        times = []
        for number in range(options.repeat):
            times.append(wall_time(options.runs, options.jobs, place / f"timed{number}"))
        # Other numbers of workers, byte by byte; one of them is this process.
        equal_runs = min(EQUAL_RUNS, options.runs)
        cpu = time.process_time()
        wall_time(equal_runs, 1, place / "equal1")
        cpu = (time.process_time() - cpu) / equal_runs
        wall_time(equal_runs, options.jobs, place / f"equal{options.jobs}")
        equal = same_files(place / "equal1", place / f"equal{options.jobs}")
    seconds = statistics.median(times)
    rows = [
        (f"{options.runs} runs of the step profile, {options.jobs} workers", f"{seconds:.1f} s",
         f"<= {LIMIT * scale:.1f} s (aim {AIM * scale:.1f})", seconds <= LIMIT * scale),
        ("  the same a run and worker",
         f"{1e3 * seconds * options.jobs / options.runs:.2f} ms", "", True),
        ("CPU time a run, in one process", f"{1e3 * cpu:.2f} ms", "", True),
        ("  simulated time a wall second", f"{0.45 * options.runs / seconds:.0f} s", "", True),
        (f"1 and {options.jobs} workers, all files", "equal" if equal else "DIFFERENT", "equal",
         equal),
    ]
    for what, value, limit, good in rows:
        print(f"{what:<50}{value:>12}   {limit:<28}{'' if good else 'MISSED'}")
    print(f"load of the machine before: {load:.2f} on {os.cpu_count()} cores; repeats {times}")
    return 0 if all(row[-1] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
