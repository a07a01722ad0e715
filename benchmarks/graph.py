"""Many actuators on one domain: samples lost, verdicts, and how soon an open interlock stops one.

Run from the checkout: ``python -m benchmarks.graph`` (``--actuators``, ``--tests``, ``--openings``
for a shorter one). Every second actuator has a turn short. Prints one JSON object a part. Exit
status 1 if a sample is lost, a verdict wrong, or a stop late.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import statistics
import sys
import tempfile
import time
from pathlib import Path
from random import Random
from typing import Any

import psutil
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from ema_cli.commands.bit import MONITOR, PROGNOSTICS, SIMULATOR
from ema_cli.console import progress
from ema_monitor.chain import Chain
from ema_record.profile import load_profile
from ema_record.wire.topics import DIAGNOSTICS
from ema_record.wire.types import stamp_of
from ema_ros.domain import enter_domain, private_domain
from ema_ros.messages import PolledGroup, make_polled_subscription, take_all
from ema_ros.supervisor import Supervisor
from support.chain import chain

STOP_LIMIT = 0.050
"""From an open interlock to the stop of the surface (s)."""
STOPPED = "stopped: "


def fleet(actuators: int, side_by_side: int, tests: int, domain: int | None) -> dict[str, Any]:
    """Test each actuator some times; return samples lost, wrong verdicts, times and memory."""
    names = [f"/actuator_{number}" for number in range(actuators)]
    profile = load_profile("extended")
    lost = wrong = failed = done = 0
    reasons: set[str] = set()
    with tempfile.TemporaryDirectory() as folder, private_domain(domain) as own:
        enter_domain(own)
        with Supervisor(Path(folder) / "nodes.log") as supervisor:
            for number, name in enumerate(names):
                hidden = {"turn_short.fraction": 0.1, "turn_short.phase": "b"}
                supervisor.start(SIMULATOR, {"seed": number, **(hidden if number % 2 else {})},
                                 name)
                supervisor.start(PROGNOSTICS, {}, name)
                supervisor.start(MONITOR, {"output_directory": folder}, name)
            begin = time.monotonic()
            found = Chain(supervisor, print)
            queue = names * -(-tests // actuators)
            results = []
            for first in range(0, len(queue), actuators):
                results += found.run(queue[first:first + actuators], side_by_side,
                                     profile.duration, 1.0, progress)
            memory = sum(
                psutil.Process(supervisor.pid(module, name)).memory_info().rss
                for module in (SIMULATOR, MONITOR, PROGNOSTICS) for name in names)
            wall = time.monotonic() - begin
        log = (Path(folder) / "nodes.log").read_text()
        reasons |= set(re.findall(r"stopped: .*", log))
    for number, result in enumerate(results):
        done += 1
        if result["verdict"] is None:
            failed += 1
            reasons.add(result["message"])
            continue
        counters = next(c for c in result["checks"] if c["name"] == "counters")["values"]
        lost += int(counters["samples_published"]) - int(counters["samples_recorded"])
        right = ("turn_short", "b") if number % actuators % 2 else (None, None)
        wrong += (result["verdict"]["fault_class"], result["verdict"]["phase"]) != right
    return {"actuators": actuators, "side_by_side": side_by_side, "tests": done, "lost": lost,
            "wrong": wrong, "failed": failed, "wall_s": round(wall, 1),
            "memory_MB": round(memory / 1e6), "reasons": sorted(reasons)}


def openings(number: int, seed: int, domain: int | None) -> dict[str, Any]:
    """Open the interlock at random moments of tests; return how late the surface was stopped.

    The times are those of the host's clock at the aircraft's message and at the status with which
    the actuator tells its stop.
    """
    rng, late, reactions = Random(seed), 0, []
    with tempfile.TemporaryDirectory() as folder, chain(Path(folder), domain=domain) as nodes:
        group = PolledGroup()
        heard = make_polled_subscription(nodes.node, DIAGNOSTICS, group)
        for _ in range(number):
            at, opened, stopped = rng.uniform(0.0, 3.0), [0], [0]

            def disturb(now: float, at: float = at, opened: list[int] = opened,
                        stopped: list[int] = stopped) -> None:
                if now >= at and not opened[0]:
                    nodes.node.weight_on_wheels = False
                    nodes.node.send_weight_on_wheels()
                    opened[0] = time.time_ns()
                for taken in take_all(heard):
                    array = deserialize_message(taken.data, DiagnosticArray)
                    if opened[0] and not stopped[0] and any(
                            status.message.startswith(STOPPED) for status in array.status):
                        stopped[0] = stamp_of(array)

            answer = nodes.run_test(disturb, 60.0)
            end = time.monotonic() + 1.0
            while opened[0] and not stopped[0] and time.monotonic() < end:
                nodes.spin()
                disturb(at)
            assert answer is not None
            if opened[0]:
                reaction = (stopped[0] - opened[0]) / 1e9 if stopped[0] else float("inf")
                reactions.append(reaction)
                late += reaction > STOP_LIMIT
            nodes.node.weight_on_wheels = True
            nodes.stay(0.6)
    return {"openings": len(reactions), "late": late,
            "median_ms": round(1e3 * statistics.median(reactions), 1),
            "largest_ms": round(1e3 * max(reactions), 1)}


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--actuators", type=int, default=8)
    parser.add_argument("--tests", type=int, default=100)
    parser.add_argument("--side-by-side", type=int, nargs="*", default=[1, 4])
    parser.add_argument("--openings", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--domain", type=int, default=None)
    options = parser.parse_args()
    good = True
    for side_by_side in options.side_by_side:
        found = fleet(options.actuators, side_by_side, options.tests, options.domain)
        good &= not (found["lost"] or found["wrong"] or found["failed"])
        print(json.dumps(found), flush=True)
    if options.openings:
        found = openings(options.openings, options.seed, options.domain)
        good &= not found["late"]
        print(json.dumps(found), flush=True)
    print(json.dumps({"load": round(os.getloadavg()[0], 1), "cores": os.cpu_count()}))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
