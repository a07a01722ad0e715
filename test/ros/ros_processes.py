"""Real nodes as processes, and a node in the test's own process to watch them."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray

from ema_cli.commands.bit import MONITOR, PROGNOSTICS, SIMULATOR
from ema_monitor.aircraft_node import answer_of
from ema_record.wire.samples import decode_block
from ema_record.wire.topics import COMMAND, DIAGNOSTICS, SAMPLES, VERDICT
from ema_record.wire.trajectory import encode_command
from ema_ros.messages import (
    PolledGroup,
    make_polled_subscription,
    make_publisher,
    read_message,
    take_all,
    values_of,
)

START_TIMEOUT = 180.0
"""The first simulator of a test run may have to compile (s)."""


def wait_until_it_listens(process):
    """Wait until a process has taken over SIGTERM; Python itself ends by it as it starts."""
    deadline = time.monotonic() + START_TIMEOUT
    caught = 0
    while not caught >> (signal.SIGTERM - 1) & 1:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.005)
        status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
        caught = int(re.search(r"SigCgt:\s+(\w+)", status)[1], 16)


def ema(*arguments, timeout=240.0):
    """Run a command and return what came of it."""
    return subprocess.run(
        [sys.executable, "-m", "ema_cli", *map(str, arguments)],
        capture_output=True, text=True, timeout=timeout, check=False,
    )


class Nodes:
    """Node processes of one test."""

    def __init__(self, folder):
        self.folder = folder
        self.processes = []
        self.last = {}

    def start(self, module, **parameters):
        """Start a node; dots in names of parameters are written ``__``."""
        arguments = []
        for name, value in parameters.items():
            arguments += ["-p", f"{name.replace('__', '.')}:={value}"]
        path = self.folder / f"{len(self.processes)}_{module}.log"
        with path.open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", module, "--ros-args", *arguments],
                stdout=subprocess.DEVNULL, stderr=log, start_new_session=True,
            )
        self.processes.append(process)
        self.last[module] = process
        return process

    def log(self, process):
        """Return what a node wrote to stderr."""
        index = self.processes.index(process)
        (path,) = self.folder.glob(f"{index}_*.log")
        return path.read_text()

    def check(self, module):
        """Fail with what the last node of a module wrote, if it has ended."""
        process = self.last.get(module)
        assert process is None or process.poll() is None, (
            f"{module} ended with status {process.returncode}: {self.log(process)}")

    def stop(self):
        """Ask all nodes to end, and require that they do, cleanly."""
        for process in self.processes:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        late = []
        for process in self.processes:
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                late.append(f"{process.args} did not end: {self.log(process)}")
        assert not late, late


class Watcher:
    """The aircraft, with eyes on diagnostics and samples."""

    def __init__(self, node, nodes):
        self.node = node
        self.nodes = nodes
        self.executor = node.executor
        group = PolledGroup()
        self._diagnostics = make_polled_subscription(node, DIAGNOSTICS, group)
        self._samples = make_polled_subscription(node, SAMPLES, group)
        self._command = make_publisher(node, COMMAND)
        self.actuator = {}
        self.actuator_history = []
        self.blocks = []
        self.send_wheels = True

    def spin(self, seconds=0.02):
        self.executor.spin_once(timeout_sec=seconds)
        self.node.poll()
        for taken in take_all(self._diagnostics):
            message = read_message(taken.data, DiagnosticArray) or DiagnosticArray()
            for status in message.status:
                if status.name == "ema_sim: actuator":
                    self.actuator = values_of(status)
                    self.actuator["message"] = status.message
                    self.actuator_history.append(self.actuator)
        self.blocks += [decode_block(taken.data) for taken in take_all(self._samples)]

    def spin_for(self, seconds, during=lambda: None):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.spin()
            during()

    def wait(self, condition, timeout=20.0, what="condition"):
        """Spin until `condition` holds; fail at once where `what` is a node that has ended."""
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, f"{what}: not within {timeout} s"
            self.nodes.check(what)
            self.spin()

    def wait_for_simulator(self):
        self.wait(
            lambda: self._command.get_subscription_count() > 0 and self.actuator,
            START_TIMEOUT, SIMULATOR,
        )

    def wait_for_monitor(self):
        self.wait(
            lambda: self.node.missing() in ("", "the prognostics", "the actuator"),
            START_TIMEOUT, MONITOR,
        )

    def wait_for_prognostics(self):
        self.wait(lambda: self.node.count_publishers(VERDICT) > 0, START_TIMEOUT, PROGNOSTICS)

    def command(self, profile):
        stamp = time.time_ns()
        self._command.publish(encode_command(profile, stamp))
        return str(stamp)

    def self_test(self, timeout=30.0, during=None):
        """Run the built-in test; `during` is called all the time while it runs."""
        future = self.node.call_self_test()
        end = time.monotonic() + timeout
        while not future.done():
            assert time.monotonic() < end, f"self_test: no answer within {timeout} s"
            self.spin()
            if during is not None:
                during()
        answer = answer_of(future.result())
        answer["by_name"] = {check["name"]: check for check in answer["checks"]}
        return answer
