"""One bag, one verdict: byte-identical JSON over repeats, paths, replay rates and workers.

Paths: `ema check` alone, among other bags, with one and with two threads of the linear algebra,
two at once; the prognostics node by the announced path, and from the topics of `ema replay` at
rates from half to a hundred times the original.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from random import Random

from std_msgs.msg import String

from benchmarks.ledger import Ledger, Row
from ema_monitor.aircraft_node import AircraftNode, aircrafts
from ema_monitor.chain import PROGNOSTICS
from ema_record.kit import share_path
from ema_record.wire.topics import BIT_RECORD
from ema_ros.domain import enter_domain, private_domain
from ema_ros.messages import make_publisher
from ema_ros.supervisor import Supervisor

BAG = "bags/sim_0001_extended"
OTHERS = ("bags/sim_0000_step", "bags/sim_0003_step")
RATES = (0.5, 1.0, 2.0, 10.0, 100.0)
PATHS = ("alone", "among others", "one thread", "two threads", "two at once", "announced",
         "topics", "topics")
NODE_TIMEOUT = 60.0


def verdict_text(verdict: dict[str, object]) -> str:
    """Return the JSON text of a verdict without the name of its bag."""
    return json.dumps({k: v for k, v in verdict.items() if k != "bag"})


def start_check(*bags: str, threads: int | None = None) -> subprocess.Popen[str]:
    """Start ``ema check --json``."""
    environment = dict(os.environ)
    if threads is not None:
        environment |= {"OPENBLAS_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}
    return subprocess.Popen(
        [sys.executable, "-m", "ema_cli", "check", *bags, "--json"], env=environment,
        stdout=subprocess.PIPE, text=True,
    )


def answer(process: subprocess.Popen[str], bag: str) -> str:
    """Return the verdict on `bag` that a started check prints."""
    out, _ = process.communicate(timeout=NODE_TIMEOUT)
    verdicts = {v["bag"]: v for v in map(json.loads, out.splitlines())}
    return verdict_text(verdicts[bag])


@contextmanager
def node(folder: Path) -> Iterator[AircraftNode]:
    """Yield a listener beside a prognostics node, in a domain of their own."""
    with private_domain(None) as domain:
        enter_domain(domain)
        with Supervisor(folder / "prognostics.log") as supervisor:
            supervisor.start(PROGNOSTICS, {})
            with aircrafts([""]) as (listener,):
                yield listener


def heard(listener: AircraftNode) -> str:
    """Return the next verdict of the node."""
    end = time.monotonic() + NODE_TIMEOUT
    while listener.verdict is None:
        listener.spin(0.02)
        listener.poll()
        if time.monotonic() > end:
            raise SystemExit(f"no verdict within {NODE_TIMEOUT:g} s")
    verdict, listener.verdict = listener.verdict, None
    return verdict_text(verdict)


def by_announcement(bag: str, folder: Path) -> str:
    """Return the verdict of a fresh node on an announced record."""
    with node(folder) as listener:
        make_publisher(listener, BIT_RECORD).publish(String(data=bag))
        return heard(listener)


def by_topics(bag: str, rate: float, folder: Path) -> str:
    """Return the verdict of a fresh node on what ``ema replay`` publishes."""
    with node(folder) as listener:
        subprocess.run(
            [sys.executable, "-m", "ema_cli", "replay", bag, "--rate", str(rate), "--wait", "60",
             "--json"], check=True, stdout=subprocess.DEVNULL,
        )
        return heard(listener)


def one(bag: str, path: str, rate: float, folder: Path) -> str:
    """Return the verdict on `bag` by one of `PATHS`."""
    if path == "announced":
        return by_announcement(bag, folder)
    if path == "topics":
        return by_topics(bag, rate, folder)
    others = [str(share_path(name)) for name in OTHERS] if path == "among others" else []
    threads = {"one thread": 1, "two threads": 2}.get(path)
    running = [start_check(*others, bag, threads=threads)
               for _ in range(2 if path == "two at once" else 1)]
    answers = {answer(process, bag) for process in running}
    return answers.pop() if len(answers) == 1 else "two at once differ"


def measure(ledger: Ledger, seed: int, *, repeats: int) -> list[Row]:
    """Judge one bag `repeats` times, by all paths in turn."""
    rng, bag = Random(seed), str(share_path(BAG))
    found: set[str] = set()
    with tempfile.TemporaryDirectory() as name:
        for number in range(repeats):
            path, rate = PATHS[number % len(PATHS)], rng.choice(RATES)
            found.add(ledger.run(f"{seed} {number} {path} {rate}",
                                 partial(one, bag, path, rate, Path(name))))
    if len(found) > 1:
        print("\n".join(sorted(found)))
    return [Row(f"{repeats} repeats of one verdict across paths, rates and workers",
                "1 distinct output", str(len(found)), len(found) == 1)]
