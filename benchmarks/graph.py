"""The graph under load: actuators side by side, openings of the interlock, CPU, time, a soak.

``python -m benchmarks.graph PART...`` from the checkout, all parts without one. Each has a
declared number of samples (``--tests`` and so on for fewer). Results are kept in a file of lines
(``--out``): a run that was cut goes on where it was; a change of the sources begins anew. Ends
with a table of limits; exit status 1 if one is missed. Every second actuator has a turn short.
"""

from __future__ import annotations

import argparse
import os
import re
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import psutil

from benchmarks.bit import LIMITS, run_bit, run_consecutive
from benchmarks.ledger import Ledger, Row
from benchmarks.openings import SCENARIOS, openings
from ema_cli.commands.bit import MONITOR, PROGNOSTICS, SIMULATOR
from ema_cli.console import progress
from ema_monitor.chain import Chain
from ema_record.errors import EmaError
from ema_record.profile import load_profile
from ema_record.sources import source_hash
from ema_ros.domain import enter_domain, private_domain
from ema_ros.supervisor import Supervisor
from support.chain import samples_of

STOP_LIMIT = 0.050
"""From an open interlock to the stop of the surface (s)."""
CPU_LIMITS = {SIMULATOR: 0.21, MONITOR: 0.14}
"""Of a core, while testing."""
GROWTH = 0.01
"""Of the memory over a soak that is no growth: of its last third over its first."""
NODES = (SIMULATOR, MONITOR, PROGNOSTICS)
PROFILE = "extended"


class Fleet(NamedTuple):
    """Actuators whose nodes run."""

    names: list[str]
    supervisor: Supervisor

    def test(self, side_by_side: int) -> dict[str, Any]:
        """Test each actuator once; return samples lost, wrong verdicts, and why tests failed."""
        profile = load_profile(PROFILE)
        found: dict[str, Any] = {"lost": 0, "wrong": 0, "failed": 0, "reasons": []}
        try:
            results = Chain(self.supervisor, print).run(
                self.names, side_by_side, profile.duration, 1.0, progress)
        except EmaError as error:
            return {**found, "failed": len(self.names), "reasons": [str(error)]}
        for number, result in enumerate(results):
            if result["verdict"] is None:
                found["failed"] += 1
                found["reasons"].append(result["message"])
                continue
            published, recorded = samples_of(result)
            found["lost"] += published - recorded
            right = ("turn_short", "b") if number % 2 else (None, None)
            verdict = result["verdict"]
            found["wrong"] += (verdict["fault_class"], verdict["phase"]) != right
        return found

    def memory(self) -> float:
        """Return the memory that the nodes hold (MB)."""
        return sum(psutil.Process(self.supervisor.pid(module, name)).memory_info().rss
                   for module in NODES for name in self.names) / 1e6


@contextmanager
def fleet(actuators: int) -> Iterator[Fleet]:
    """Yield actuators on a domain of their own; every second one has a turn short."""
    names = [f"/actuator_{number}" for number in range(actuators)]
    with tempfile.TemporaryDirectory() as folder, private_domain(None) as domain:
        enter_domain(domain)
        log = Path(folder) / "nodes.log"
        with Supervisor(log) as supervisor:
            for number, name in enumerate(names):
                hidden = {"turn_short.fraction": 0.1, "turn_short.phase": "b"}
                supervisor.start(SIMULATOR, {"seed": number, **(hidden if number % 2 else {})},
                                 name)
                supervisor.start(PROGNOSTICS, {}, name)
                supervisor.start(MONITOR, {"output_directory": folder}, name)
            yield Fleet(names, supervisor)
        for line in sorted(set(re.findall(r"stopped: .*", log.read_text()))):
            print(line)


class Benchmark:
    """The parts; each returns its rows of the table."""

    def __init__(self, options: argparse.Namespace) -> None:
        """Read what an earlier run left."""
        self.options = options
        self._ledger = Ledger(options.out)
        self._of = source_hash("ema_sim.simulator_node", "ema_monitor.monitor_node",
                               "ema_prognostics.prognostics_node")[:8]

    def _all(
        self, part: str, count: int, make: Callable[[list[str]], Iterator[tuple[str, Any]]]
    ) -> list[Any]:
        """Return the results of a part, those made that are not there yet."""
        keys = [f"{self._of} {part} {number}" for number in range(count)]
        missing = [key for key in keys if key not in self._ledger.keys]
        if missing:
            print(f"{part}: {len(missing)} of {count} to do", flush=True)
            for key, result in make(missing):
                self._ledger.run(key, lambda result=result: result)
        return [self._ledger.run(key, dict) for key in keys]

    def _fleet(self, side_by_side: int) -> list[Row]:
        actuators, tests = self.options.actuators, self.options.tests

        def make(missing: list[str]) -> Iterator[tuple[str, Any]]:
            with fleet(actuators) as found:
                for key in missing:
                    yield key, found.test(side_by_side)

        rounds = self._all(f"{actuators} actuators, {side_by_side} at once",
                           -(-tests // actuators), make)
        lost, wrong, failed = (sum(r[name] for r in rounds) for name in ("lost", "wrong",
                                                                         "failed"))
        for reason in sorted({reason for r in rounds for reason in r["reasons"]}):
            print(reason)
        what = f"{actuators} actuators, {side_by_side} at once, {len(rounds) * actuators} tests"
        return [Row(what, "0 samples lost, 0 verdicts wrong, 0 tests failed",
                    f"{lost} lost, {wrong} wrong, {failed} failed", not lost + wrong + failed)]

    def one(self) -> list[Row]:
        """Test eight actuators one after another."""
        return self._fleet(1)

    def four(self) -> list[Row]:
        """Test them four at a time."""
        return self._fleet(4)

    def openings(self) -> list[Row]:
        """Open the interlock at any moment of a test, also where others are in the way."""
        rows = []
        for scenario in SCENARIOS:
            found = self._all(f"opening, {scenario}", self.options.openings,
                              lambda missing, scenario=scenario: openings(missing, scenario))
            late = sum(not took <= STOP_LIMIT for took in found)
            rows.append(Row(
                f"interlock opens, {scenario}, {len(found)} times",
                f"stopped within {1e3 * STOP_LIMIT:g} ms each time",
                f"{late} late, median {1e3 * statistics.median(found):.1f} ms, longest "
                f"{1e3 * max(found):.1f} ms", not late))
        return rows

    def cpu(self) -> list[Row]:
        """Look at the CPU that simulator and monitor take while they test."""
        def make(missing: list[str]) -> Iterator[tuple[str, Any]]:
            with tempfile.TemporaryDirectory() as folder:
                found = run_consecutive(self.options.cpu_tests, PROFILE, Path(folder))
                yield missing[0], {"cpu": found.cpu, "failed": found.failed}

        (found,) = self._all(f"CPU over {self.options.cpu_tests} tests", 1, make)
        return [Row(f"CPU of {module.split('.')[0]}, {self.options.cpu_tests} tests",
                    f"{100 * limit:.0f} % of a core", f"{100 * found['cpu'][module]:.1f} %",
                    found["cpu"][module] <= limit and not found["failed"])
                for module, limit in CPU_LIMITS.items()]

    def bit(self) -> list[Row]:
        """Take the time of a warm `ema bit`."""
        rows = []
        for profile, limit in LIMITS.items():
            def make(missing: list[str], profile: str = profile) -> Iterator[tuple[str, Any]]:
                with tempfile.TemporaryDirectory() as folder:
                    run_bit("step", Path(folder))
                    for key in missing:
                        yield key, run_bit(profile, Path(folder))[0]

            found = self._all(f"ema bit, {profile}", self.options.repeat, make)
            wall = statistics.median(found)
            rows.append(Row(f"warm ema bit, {profile}, median of {len(found)}", f"{limit:g} s",
                            f"{wall:.2f} s (longest {max(found):.2f} s)", wall <= limit))
        return rows

    def soak(self) -> list[Row]:
        """Test for a long time; one that was cut begins anew."""
        minutes, actuators = self.options.minutes, self.options.actuators

        def make(missing: list[str]) -> Iterator[tuple[str, Any]]:
            total = {"lost": 0, "wrong": 0, "failed": 0, "tests": 0, "memory": []}
            with fleet(actuators) as found:
                begin = time.monotonic()
                while time.monotonic() - begin < 60.0 * minutes or len(total["memory"]) < 4:
                    result = found.test(1)
                    for name in ("lost", "wrong", "failed"):
                        total[name] += result[name]
                    total["tests"] += actuators
                    total["memory"].append(round(found.memory(), 1))
                    print(f"{(time.monotonic() - begin) / 60.0:.1f} min: {total['tests']} tests, "
                          f"{total['lost']} lost, {total['memory'][-1]} MB", flush=True)
            yield missing[0], total

        (found,) = self._all(f"soak, {actuators} actuators, {minutes:g} min", 1, make)
        memory = found["memory"][1:]  # the first round loads what it needs
        third = max(1, len(memory) // 3)
        before, after = statistics.median(memory[:third]), statistics.median(memory[-third:])
        bad = found["lost"] + found["wrong"] + found["failed"]
        return [Row(f"soak, {actuators} actuators, {minutes:g} min, {found['tests']} tests",
                    f"0 lost, memory of the last third at most {100 * GROWTH:g} % over the first",
                    f"{found['lost']} lost, {found['wrong']} wrong, {found['failed']} failed; "
                    f"{before:.0f} MB, {after:.0f} MB",
                    not bad and after <= before * (1.0 + GROWTH))]


PARTS = ("one", "four", "openings", "cpu", "bit", "soak")


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--actuators", type=int, default=8)
    parser.add_argument("--tests", type=int, default=100, help="of one, four")
    parser.add_argument("--openings", type=int, default=200, help="of each kind")
    parser.add_argument("--cpu-tests", type=int, default=20)
    parser.add_argument("--repeat", type=int, default=5, help="of ema bit, each profile")
    parser.add_argument("--minutes", type=float, default=30.0, help="of the soak")
    parser.add_argument("--out", type=Path, default=Path("build/graph.jsonl"))
    options = parser.parse_args()
    unknown = set(options.parts) - set(PARTS)
    if unknown:
        parser.error(f"no part {', '.join(sorted(unknown))}: give some of {', '.join(PARTS)}")
    load = os.getloadavg()[0]
    benchmark = Benchmark(options)
    rows = [row for part in options.parts or PARTS for row in getattr(benchmark, part)()]
    for row in rows:
        print(f"{'met' if row.good else 'MISSED':6}  {row.what}: {row.found} "
              f"(limit: {row.target})")
    print(f"load average at the begin {load:.1f} on {os.cpu_count()} cores")
    return 0 if all(row.good for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
