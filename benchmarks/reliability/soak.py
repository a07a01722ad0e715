"""Built-in tests back to back for half an hour: memory of each node, and samples lost.

The resident memory of each node is read every two seconds. After a warm-up of a tenth of the time
it is flat where the mean of the last fifth is within 5 % of that of the first fifth.
"""

from __future__ import annotations

import json
import shutil
import statistics
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from benchmarks.ledger import Ledger, Row
from ema_cli.commands.bit import MONITOR, PROGNOSTICS, SIMULATOR
from support.chain import Chain, chain, samples_of

NODES = {"simulator": SIMULATOR, "monitor": MONITOR, "prognostics": PROGNOSTICS}
PERIOD = 2.0
"""Interval of the memory readings (s)."""
WARM_UP = 0.1
FLAT = 0.05
TEST_LIMIT = 60.0


class Memory:
    """Resident memory of the nodes over time."""

    def __init__(self, found: Chain) -> None:
        """Find the processes; this one, the aircraft, is looked at too."""
        self._processes = {name: found.process(module) for name, module in NODES.items()}
        self._processes["aircraft"] = psutil.Process()
        self._begin = time.monotonic()
        self._next = 0.0
        self.rows: list[tuple[float, dict[str, float]]] = []

    def look(self, _: float = 0.0) -> None:
        """Read it, if it is time to (MiB)."""
        now = time.monotonic() - self._begin
        if now >= self._next:
            self._next = now + PERIOD
            self.rows.append((now, {
                name: process.memory_info().rss / 2**20
                for name, process in self._processes.items()
            }))

    def cpu(self) -> dict[str, float]:
        """Return the CPU time of each process (s)."""
        return {name: sum(process.cpu_times()[:2]) for name, process in self._processes.items()}

    def growth(self) -> dict[str, dict[str, float]]:
        """Return begin and end of each process's memory (MiB) and their ratio."""
        end = self.rows[-1][0]
        warm = WARM_UP * end
        fifth = 0.2 * (end - warm)
        found = {}
        for name in self._processes:
            values = [(t, row[name]) for t, row in self.rows]
            first = statistics.fmean(v for t, v in values if warm <= t <= warm + fifth)
            last = statistics.fmean(v for t, v in values if t >= end - fifth)
            found[name] = {"begin_MiB": round(first, 2), "end_MiB": round(last, 2),
                           "growth": round(last / first - 1.0, 4)}
        return found


def soak(minutes: float, seed: int) -> dict[str, Any]:
    """Return the sums over all tests of `minutes`."""
    tests = passed = published = recorded = healthy = 0
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        with chain(out, simulator={"seed": seed}) as found:
            memory = Memory(found)
            begin = time.monotonic()
            cpu = memory.cpu()
            while (wall := time.monotonic() - begin) < 60.0 * minutes:
                answer = found.run_test(memory.look, TEST_LIMIT)
                assert answer is not None
                tests += 1
                passed += bool(answer["passed"])
                sent, kept = samples_of(answer)
                published, recorded = published + sent, recorded + kept
                record = answer["record"]
                found.wait(
                    lambda: (found.node.verdict or {}).get("bag") == record,  # noqa: B023
                    TEST_LIMIT, "the verdict",
                )
                assert found.node.verdict is not None
                healthy += found.node.verdict["verdict"] == "healthy"
                shutil.rmtree(record)
                if tests % 20 == 0:
                    print(json.dumps({"minutes": round(wall / 60.0, 1), "tests": tests,
                                      **memory.rows[-1][1]}), file=sys.stderr, flush=True)
            used = {name: (value - cpu[name]) / wall for name, value in memory.cpu().items()}
            growth = memory.growth()
    return {
        "minutes": round(wall / 60.0, 2), "tests": tests, "passed": passed, "healthy": healthy,
        "samples_published": published, "samples_recorded": recorded,
        "lost": published - recorded, "memory": growth,
        "flat": all(abs(row["growth"]) <= FLAT for row in growth.values()),
        "cpu_of_a_core": {name: round(value, 3) for name, value in used.items()},
    }


def measure(ledger: Ledger, seed: int, *, minutes: float) -> list[Row]:
    """Test for `minutes`."""
    r = ledger.run(f"{seed} {minutes}", partial(soak, minutes, seed))
    print(json.dumps({"CPU of a core": r["cpu_of_a_core"], "healthy": r["healthy"]}))
    growth = ", ".join(f"{name} {100 * m['growth']:+.1f} %" for name, m in r["memory"].items())
    return [Row(f"{r['minutes']} minutes of continuous tests ({r['tests']})",
                "memory flat within 5 %, 0 samples lost",
                f"{growth}; {r['lost']} of {r['samples_published']} lost",
                bool(r["flat"]) and r["lost"] == 0 and r["passed"] == r["tests"])]
