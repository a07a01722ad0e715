"""Time of `ema bit`, samples lost in consecutive built-in tests, CPU of publisher and recorder.

Run from the checkout: ``python -m benchmarks.bit`` (``--tests N`` and ``--repeat N`` for a
shorter one). Simulator, monitor and prognostics are processes of their own, over DDS, paced to
real time at 20 kHz. Times are medians after one run that is not counted. Exit status 1 if a
limit is missed or a sample lost.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from ema_cli.commands.bit import MONITOR, SIMULATOR
from ema_record.profile import load_profile
from support.chain import chain, samples_of

LIMITS = {"step": 3.0, "extended": 6.0}
"""Of a warm `ema bit` (s)."""
AFTER_CLOSED = 1.0
"""Of that, at most so much after the record is closed (s)."""
TESTS = 50
TIMEOUT = 240.0


def run_bit(profile: str, out: Path) -> tuple[float, float]:
    """Return the wall time of one `ema bit` and its part after the record was closed (s)."""
    begin = time.perf_counter()
    run = subprocess.run(
        [sys.executable, "-m", "ema_cli", "bit", "--profile", profile, "--out", str(out),
         "--json"],
        capture_output=True, text=True, timeout=TIMEOUT, check=False,
    )
    wall = time.perf_counter() - begin
    if not run.stdout:
        raise SystemExit(f"ema bit --profile {profile}: {run.stderr}")
    return wall, json.loads(run.stdout)["times"]["after_record_closed"]


class Consecutive(NamedTuple):
    """Sums over consecutive tests on one set of nodes."""

    failed: int
    published: int
    recorded: int
    cpu: dict[str, float]
    """Of a core, by module, while testing."""


def run_consecutive(tests: int, profile: str, out: Path) -> Consecutive:
    """Return the sums over consecutive tests."""
    start = {"initial_position": load_profile(profile).start}
    passed = published = recorded = 0
    with chain(out, simulator=start, profile=profile) as nodes:
        processes = {module: nodes.process(module) for module in (SIMULATOR, MONITOR)}
        before = {module: sum(p.cpu_times()[:2]) for module, p in processes.items()}
        begin = time.monotonic()
        for _ in range(tests):
            answer = nodes.run_test(lambda _: None, TIMEOUT)
            assert answer is not None
            passed += bool(answer["passed"])
            sent, kept = samples_of(answer)
            published, recorded = published + sent, recorded + kept
        wall = time.monotonic() - begin
        cpu = {module: (sum(p.cpu_times()[:2]) - before[module]) / wall
               for module, p in processes.items()}
    return Consecutive(tests - passed, published, recorded, cpu)


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--tests", type=int, default=TESTS)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--profile", default="extended", help="of the consecutive tests")
    options = parser.parse_args()
    good = True
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        run_bit("step", out)
        load = os.getloadavg()[0]
        for profile, limit in LIMITS.items():
            walls, after = zip(*(run_bit(profile, out) for _ in range(options.repeat)))
            wall, closed = statistics.median(walls), statistics.median(after)
            good &= wall <= limit and closed <= AFTER_CLOSED
            print(f"ema bit, {profile:9} {wall:6.2f} s  (limit {limit:g} s)   verdict after the "
                  f"record is closed {closed:5.2f} s  (limit {AFTER_CLOSED:g} s)")
        found = run_consecutive(options.tests, options.profile, out)
    lost = found.published - found.recorded
    good &= lost == 0 and found.failed == 0
    print(f"{options.tests} consecutive tests ({options.profile}), {found.published} samples "
          f"published, {found.recorded} recorded, {lost} lost (limit 0), {found.failed} failed")
    print(f"CPU of a core while testing: publisher (simulation included) "
          f"{100 * found.cpu[SIMULATOR]:.1f} %, recorder (checks included) "
          f"{100 * found.cpu[MONITOR]:.1f} %")
    print(f"load average at the begin {load:.1f} on {os.cpu_count()} cores")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
