"""Time of `ema bit`, samples lost in consecutive built-in tests, CPU of publisher and recorder.

Run from the checkout: ``python -m benchmarks.bit`` (``--tests N`` and ``--repeat N`` for a
shorter one). Simulator, monitor and prognostics are processes of their own, over DDS, paced to
real time at 20 kHz. Times are medians after one run that is not counted. Exit status 1 if a
limit is missed or a sample lost.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

from ema_cli.commands.bit import MONITOR, PROGNOSTICS, SIMULATOR, summarise
from ema_monitor.aircraft_node import AircraftNode, aircraft, answer_of
from ema_record.profile import load_profile
from ema_ros.domain import enter_domain, private_domain
from ema_ros.supervisor import Supervisor

LIMITS = {"step": 8.0, "extended": 12.0}
"""Of a warm `ema bit` (s)."""
AFTER_CLOSED = 1.0
"""Of that, at most so much after the record is closed (s)."""
TESTS = 50
SPIN = 0.02
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


class Consecutive:
    """Consecutive tests on one set of nodes."""

    def __init__(self, node: AircraftNode, supervisor: Supervisor) -> None:
        """Find the processes of the nodes."""
        self._node, self._supervisor = node, supervisor
        children = psutil.Process().children(recursive=True)
        self._processes = {
            module: next(c for c in children if module in c.cmdline())
            for module in (SIMULATOR, MONITOR)
        }
        self.published = self.recorded = self.tests = self.failed = 0
        self.wall = 0.0
        self.cpu = dict.fromkeys(self._processes, 0.0)

    def wait(self, until: Any) -> None:
        """Play the aircraft until something is true."""
        end = time.monotonic() + TIMEOUT
        while not until():
            self._node.spin(SPIN)
            self._node.poll()
            self._supervisor.check()
            if time.monotonic() > end:
                raise SystemExit("no answer from the nodes")

    def run(self) -> None:
        """Run one test and add up its counters."""
        before = self._cpu_times()
        begin = time.monotonic()
        answer = self._node.call_self_test()
        self.wait(answer.done)
        self.wall += time.monotonic() - begin
        for module, seconds in self._cpu_times().items():
            self.cpu[module] += seconds - before[module]
        result = summarise(answer_of(answer.result()))
        self.tests += 1
        self.failed += not result["passed"]
        for check in result["checks"]:
            if check["name"] == "counters":
                self.published += int(check["values"]["samples_published"])
                self.recorded += int(check["values"]["samples_recorded"])

    def _cpu_times(self) -> dict[str, float]:
        return {module: sum(process.cpu_times()[:2])
                for module, process in self._processes.items()}


def run_consecutive(tests: int, profile: str, out: Path) -> Consecutive:
    """Return the sums over consecutive tests."""
    with contextlib.ExitStack() as stack:
        enter_domain(stack.enter_context(private_domain(None)))
        supervisor = stack.enter_context(Supervisor(out / "nodes.log"))
        supervisor.start(SIMULATOR, {"initial_position": load_profile(profile).start})
        supervisor.start(PROGNOSTICS, {})
        supervisor.start(MONITOR, {"profile": profile, "output_directory": str(out)})
        node = stack.enter_context(aircraft())
        found = Consecutive(node, supervisor)
        found.wait(lambda: not node.missing())
        for _ in range(tests):
            found.run()
        return found


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
    good &= lost == 0 and found.failed == 0 and found.tests == options.tests
    print(f"{found.tests} consecutive tests ({options.profile}), {found.published} samples "
          f"published, {found.recorded} recorded, {lost} lost (limit 0), {found.failed} failed")
    print(f"CPU of a core while testing: publisher (simulation included) "
          f"{100 * found.cpu[SIMULATOR] / found.wall:.1f} %, recorder (checks included) "
          f"{100 * found.cpu[MONITOR] / found.wall:.1f} %")
    print(f"load average at the begin {load:.1f} on {os.cpu_count()} cores")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
