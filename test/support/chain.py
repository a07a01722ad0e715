"""The whole chain as processes, to be disturbed: nodes, aircraft, clock, and what they say."""

from __future__ import annotations

import contextlib
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from ema_cli.commands.bit import MONITOR, PROGNOSTICS, SIMULATOR
from ema_monitor.aircraft_node import AircraftNode, aircrafts, answer_of
from ema_monitor.chain import summarise
from ema_record.wire.topics import DIAGNOSTICS
from ema_ros.domain import enter_domain, private_domain
from ema_ros.messages import PolledGroup, make_polled_subscription, take_all, values_of
from ema_ros.supervisor import Supervisor

NODES = (SIMULATOR, PROGNOSTICS, MONITOR)
READY_TIMEOUT = 180.0
SHARED_MEMORY = Path("/dev/shm")
MONITOR_STATUS, ACTUATOR_STATUS = "ema_monitor: test", "ema_sim: actuator"


class TimedOutError(Exception):
    """Something that is bounded took longer than its bound."""


class Clock:
    """The clock of all nodes, which can be stepped (see clock_step.c)."""

    def __init__(self, folder: Path) -> None:
        """Compile the shim and begin without a step."""
        library, self._file = folder / "clock_step.so", folder / "clock_step"
        source = Path(__file__).with_name("clock_step.c")
        subprocess.run(
            ["cc", "-shared", "-fPIC", "-O1", "-o", str(library), str(source)], check=True
        )
        self._file.write_bytes(bytes(4096))
        self.environment = {"LD_PRELOAD": str(library), "CLOCK_STEP_FILE": str(self._file)}
        self.total = 0.0

    def step(self, seconds: float) -> None:
        """Step the clock (s)."""
        self.total += seconds
        with self._file.open("r+b") as stream:
            stream.write(struct.pack("<q", round(self.total * 1e9)))


class Chain:
    """Simulator, prognostics and monitor in one domain, and the aircraft in this process."""

    def __init__(
        self, node: AircraftNode, supervisor: Supervisor, out: Path, parameters: dict[str, Any]
    ) -> None:
        """Remember what to start."""
        self.node, self.out = node, out
        self._supervisor = supervisor
        self._parameters = parameters
        self.clock: Clock | None = None
        self.pids: list[int] = []
        self.status: dict[str, tuple[str, dict[str, str]]] = {}
        self._diagnostics = make_polled_subscription(node, DIAGNOSTICS, PolledGroup())

    def start(self, *modules: str) -> None:
        """Start nodes that do not run."""
        for module in modules:
            self._supervisor.start(module, self._parameters[module])
            self.pids.append(self.process(module).pid)

    def process(self, module: str) -> psutil.Process:
        """Return the process of a node."""
        return psutil.Process(self._supervisor.pid(module))

    def runs(self, module: str) -> bool:
        """Return whether a node runs."""
        try:
            return self.process(module).status() != psutil.STATUS_ZOMBIE
        except psutil.NoSuchProcess:
            return False

    def send_signal(self, module: str, number: signal.Signals) -> None:
        """Send a signal to a node."""
        os.kill(self._supervisor.pid(module), number)

    def spin(self, seconds: float = 0.02) -> None:
        """Do what the aircraft does, and listen."""
        self.node.spin(seconds)
        self.node.poll()
        for taken in take_all(self._diagnostics):
            for status in deserialize_message(taken.data, DiagnosticArray).status:
                values = values_of(status)
                self.status[status.name] = status.message, values

    def wait(self, until: Callable[[], bool], limit: float, what: str) -> float:
        """Return after how long something is true (s)."""
        begin = time.monotonic()
        while not until():
            self.spin()
            if time.monotonic() - begin > limit:
                raise TimedOutError(f"{what}: not within {limit:g} s")
        return time.monotonic() - begin

    def stay(self, seconds: float) -> None:
        """Go on for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.spin()

    def ready(self) -> None:
        """Wait until every node is there, starting those that have ended."""

        def up() -> bool:
            ended = [module for module in NODES if not self.runs(module)]
            self.start(*ended)
            return not ended and not self.node.missing()

        self.wait(up, READY_TIMEOUT, "the nodes")

    def stage(self) -> str:
        """Return the stage of the test."""
        return self.status.get(MONITOR_STATUS, ("", {}))[1].get("stage", "")

    def run_test(
        self, disturb: Callable[[float], None], limit: float,
        lost: Callable[[], bool] = lambda: False,
    ) -> dict[str, Any] | None:
        """Run one test; `disturb` is called all the time with the time since it records (s).

        Returns the answer, or None where `lost` says that none can come.
        """
        answer = self.node.call_self_test()
        begin = time.monotonic()
        recording: float | None = None
        while not answer.done():
            self.spin(0.01)
            now = time.monotonic()
            if recording is None and self.stage() == "testing":
                recording = now
            if recording is not None:
                disturb(now - recording)
            if lost():
                return None
            if now - begin > limit:
                raise TimedOutError(f"self_test: no answer within {limit:g} s")
        return summarise(answer_of(answer.result()))


@contextmanager
def chain(
    out: Path, *, domain: int | None = None, simulator: dict[str, Any] | None = None,
    monitor: dict[str, Any] | None = None, profile: str = "extended",
) -> Iterator[Chain]:
    """Yield a chain that is ready; all of it is ended with the block."""
    with contextlib.ExitStack() as stack:
        enter_domain(stack.enter_context(private_domain(domain)))
        supervisor = stack.enter_context(Supervisor(out / "nodes.log"))
        (node,) = stack.enter_context(aircrafts([""]))
        found = Chain(node, supervisor, out, {
            SIMULATOR: simulator or {}, PROGNOSTICS: {},
            MONITOR: {"profile": profile, "output_directory": str(out), **(monitor or {})},
        })
        found.start(*NODES)
        found.ready()
        yield found


def samples_of(answer: dict[str, Any]) -> tuple[int, int]:
    """Return the samples published and recorded in a test."""
    counters = next(c for c in answer["checks"] if c["name"] == "counters")["values"]
    return int(counters["samples_published"]), int(counters["samples_recorded"])


def slow_reader() -> subprocess.Popen[bytes]:
    """Start a reader of all samples that takes two messages a second."""
    return subprocess.Popen([sys.executable, str(Path(__file__).with_name("slow_node.py"))])


def left_in_shared_memory() -> set[str]:
    """Return the files of the middleware for the ports of this domain."""
    first = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"])
    ports = {f"fastrtps_port{port}" for port in range(first, first + 250)}
    return {p.name for p in SHARED_MEMORY.iterdir() if p.name.removesuffix("_el") in ports}
