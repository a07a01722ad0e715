"""The node `aircraft`: weight on wheels, and the crew that asks for the built-in test."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any

import rclpy
import rclpy.executors
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.srv import SelfTest
from lifecycle_msgs.srv import GetState
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Bool

from ema_record.wire.topics import (
    SAMPLES,
    SELF_TEST_SERVICE,
    VERDICT,
    WEIGHT_ON_WHEELS,
)
from ema_ros.ema_node import LOOK_FOR_OTHERS
from ema_ros.messages import (
    PolledGroup,
    make_polled_subscription,
    make_publisher,
    make_timer,
    read_message,
    resolved,
    take_all,
    values_of,
)
from ema_ros.process import spun

NODE_NAME = "aircraft"
SIMULATOR = "ema_sim"
LIFECYCLE_NODES = (SIMULATOR, "ema_monitor", "ema_prognostics")
"""Those that the test waits for."""
AT_ONCE = 1
"""Callbacks beyond the first that are done without a wait, if they are due."""
PERIOD = 0.1
"""Interval of weight on wheels (s)."""
ASK_AGAIN = 1.0
"""After which a question without an answer is asked again (s).

A request, and its answer, is lost where one side has found the other and not yet been found.
"""


def aircrafts(namespaces: Sequence[str]) -> AbstractContextManager[Sequence[AircraftNode]]:
    """Yield a node for each actuator, by its namespace; all are spun together.

    They are in a context of their own, which leaves the signals to the caller.
    """
    return spun(rclpy, lambda context: [AircraftNode(context, namespace, first=number == 0)
                                        for number, namespace in enumerate(namespaces)])


class AircraftNode(Node):
    """Sends weight on wheels, calls the self-test of one actuator, listens for its verdict."""

    def __init__(self, context: rclpy.Context, namespace: str, *, first: bool) -> None:
        """Appear on the graph, on the ground, in the namespace of the actuator.

        Only the first one of an aircraft sends weight on wheels.
        """
        super().__init__(  # without services that nobody calls: each costs the executor
            NODE_NAME, context=context, namespace=namespace, start_parameter_services=False)
        self.weight_on_wheels = True
        self.send = True
        """Whether weight on wheels is sent ten times a second."""
        self.gives_way = False
        """Whether it is left to another aircraft on the domain, if there is one."""
        self.verdict: dict[str, Any] | None = None
        """The last verdict, as `ema check --json` prints it."""
        self._verdict = make_polled_subscription(self, VERDICT, PolledGroup())
        self._wheels = make_publisher(self, WEIGHT_ON_WHEELS) if first else None
        self._born = time.monotonic()
        self._test = self.create_client(SelfTest, SELF_TEST_SERVICE.removeprefix("/"))
        self._states = {
            name: self.create_client(GetState, f"{name}/get_state") for name in LIFECYCLE_NODES
        }
        self._asked: dict[str, tuple[Future, float]] = {}
        self._active: set[str] = set()
        if first:
            make_timer(self, PERIOD, self._on_timer)

    def spin(self, seconds: float) -> None:
        """Do what is due, waiting at most so long for it (s)."""
        assert self.executor is not None
        self.executor.spin_once(timeout_sec=seconds)
        for _ in range(AT_ONCE):
            self.executor.spin_once(timeout_sec=0.0)

    def _on_timer(self) -> None:
        if self.gives_way:
            if time.monotonic() - self._born < LOOK_FOR_OTHERS:
                return
            if self.count_publishers(resolved(self, WEIGHT_ON_WHEELS)) > 1:  # one is ours
                return
        if self.send:
            self.send_weight_on_wheels()

    def state(self, name: str) -> str:
        """Return what a lifecycle node says of its state; empty: it is active.

        It is asked anew until it is. While it loads and compiles it does not answer.
        """
        if name in self._active:
            return ""
        answer, asked = self._asked.get(name, (None, 0.0))
        if answer is not None and answer.done():
            label = answer.result().current_state.label
            del self._asked[name]
            if label == "active":
                self._active.add(name)
                self.destroy_client(self._states.pop(name))
                return ""
            return str(label)
        if not self._states[name].service_is_ready():
            return "starting"
        if answer is None or time.monotonic() - asked > ASK_AGAIN:
            if answer is not None:
                self._states[name].remove_pending_request(answer)
            self._asked[name] = (
                self._states[name].call_async(GetState.Request()), time.monotonic())
        return "loading"

    def waiting_for(self, with_driver: bool = False) -> str:
        """Return which nodes are not active yet, and what else is missing; empty: nothing.

        A driver of somebody else has no state that we know of.
        """
        states = {name: self.state(name) for name in LIFECYCLE_NODES
                  if not (with_driver and name == SIMULATOR)}
        late = [f"{name} ({state})" for name, state in states.items() if state]
        return ", ".join(late) or self.missing()

    def send_weight_on_wheels(self) -> None:
        """Publish whether the aircraft stands on its wheels."""
        if self._wheels is not None:
            self._wheels.publish(Bool(data=self.weight_on_wheels))

    def missing(self) -> str:
        """Return what the test still waits for; empty: nothing."""
        if not self._test.service_is_ready():
            return "the monitor"
        if self._wheels is not None and self._wheels.get_subscription_count() < 1:
            return "the monitor's interlock"
        if self.count_publishers(resolved(self, SAMPLES)) < 1:
            return "the actuator"
        if self._verdict.get_publisher_count() < 1:
            return "the prognostics"
        return ""

    def call_self_test(self) -> Future:
        """Ask for the built-in test; the future holds the answer."""
        return self._test.call_async(SelfTest.Request())

    def poll(self) -> None:
        """Take verdicts that have arrived."""
        for taken in take_all(self._verdict):
            verdict = read_message(taken.data, DiagnosticStatus)
            if verdict is not None:
                self.verdict = verdict_of(verdict) or self.verdict


def verdict_of(status: DiagnosticStatus) -> dict[str, Any] | None:
    """Return the verdict that a message of `/ema/verdict` carries, None: it is none of ours."""
    try:
        found = json.loads(values_of(status).get("json", ""))
    except ValueError:
        return None
    return found if isinstance(found, dict) and "bag" in found else None


def answer_of(response: SelfTest.Response) -> dict[str, Any]:
    """Return the answer of the self-test as plain data."""
    return {
        "serial_number": response.id,
        "passed": response.passed != b"\x00",
        "checks": [
            {
                "name": status.name.partition(": ")[2] or status.name,
                "level": int.from_bytes(status.level, "little"),
                "message": status.message,
                "values": values_of(status),
            }
            for status in response.status
        ],
    }
