"""Openings of the interlock at any moment of a test, and how soon the actuator stops."""

from __future__ import annotations

import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from random import Random

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from ema_cli.commands.bit import MONITOR
from ema_record.wire.topics import DIAGNOSTICS, SELF_TEST_SERVICE
from ema_record.wire.types import NANOSECONDS, stamp_of
from ema_ros.messages import PolledGroup, make_polled_subscription, take_all, values_of
from support.chain import MONITOR_STATUS, Chain, chain, slow_reader

SCENARIOS = ("alone", "eight callers", "slow reader", "killed monitor")
CALLERS = 8
LATEST = 4.0
"""Latest opening after the call (s); the default test is over soon after."""
KILLED_BEFORE = 0.5
"""By how much the monitor is killed before the interlock opens, at most (s); its silence alone
stops the surface 1 s after its last sign."""
GIVEN_UP = 3.0
"""Longest wait for the stop (s)."""
ANSWERED = 20.0
STOPPED, EXECUTED = "stopped: ", "command executed"


class Opening:
    """One test, and the opening of the interlock in it.

    Parameters
    ----------
    nodes : run the test.
    scenario : one of `SCENARIOS`.
    rng : tells when.
    """

    def __init__(self, nodes: Chain, scenario: str, rng: Random) -> None:
        """Listen to the actuator."""
        self._nodes, self._scenario = nodes, scenario
        self._at = rng.uniform(0.0, LATEST)
        self._kill_at = self._at - rng.uniform(0.0, KILLED_BEFORE)
        self._heard = make_polled_subscription(nodes.node, DIAGNOSTICS, PolledGroup())
        self._active = self._killed = self._was_over = False
        self._opened = self._stopped = 0

    def run(self) -> float | None:
        """Return the time from the open interlock to the stop (s); None: the move was over."""
        nodes = self._nodes
        self._calls = [nodes.node.call_self_test()]
        begin = time.monotonic()
        while not self._stopped:
            nodes.spin(0.005)
            now = time.monotonic() - begin
            self._listen()
            if self._active and now >= self._kill_at:
                self._kill()
            if self._active and now >= self._at and not self._opened:
                self._open()
            over = self._was_over or (self._calls[0].done() and not self._opened)
            if over or now > self._at + ANSWERED or (
                self._opened and time.time_ns() - self._opened > GIVEN_UP * NANOSECONDS
            ):
                break
        self._end()
        if not self._opened or self._was_over:
            return None
        if not self._stopped:
            return GIVEN_UP
        return (self._stopped - self._opened) / NANOSECONDS

    def _listen(self) -> None:
        for taken in take_all(self._heard):
            array = deserialize_message(taken.data, DiagnosticArray)
            for status in array.status:
                if not status.name.endswith(": actuator"):
                    continue
                values = values_of(status)
                self._active = values.get("state") == "active"
                if not self._opened or self._stopped:
                    continue
                if stamp_of(array) >= self._opened and status.message.startswith(STOPPED):
                    self._stopped = stamp_of(array)
                elif status.message == EXECUTED and not self._active:
                    self._was_over = True  # its move ended by itself before it heard of it

    def _kill(self) -> None:
        if self._scenario == "killed monitor" and not self._killed:
            self._killed = True
            self._nodes.send_signal(MONITOR, signal.SIGKILL)

    def _open(self) -> None:
        node = self._nodes.node
        if self._scenario == "eight callers":
            self._calls += [node.call_self_test() for _ in range(CALLERS - 1)]
        node.weight_on_wheels = False
        self._opened = time.time_ns()
        node.send_weight_on_wheels()

    def _end(self) -> None:
        """Close the interlock when all callers are answered; a killed monitor is started."""
        nodes = self._nodes
        if self._killed:
            nodes.status.clear()
            nodes.ready()
            nodes.wait(self._monitor_is_new, ANSWERED, "the new monitor alone")
        else:
            nodes.wait(lambda: all(call.done() for call in self._calls), ANSWERED, "the answers")
        nodes.node.weight_on_wheels = True
        nodes.stay(1.4)
        nodes.node.destroy_subscription(self._heard)

    def _monitor_is_new(self) -> bool:
        """Whether the new monitor is there, and the dead one is forgotten by all."""
        services = self._nodes.node.count_services(SELF_TEST_SERVICE)
        return MONITOR_STATUS in self._nodes.status and services == 1


def openings(keys: list[str], scenario: str) -> Iterator[tuple[str, float]]:
    """Yield how long each stop took (s), by key; where the move was over it is done again."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        nodes = stack.enter_context(chain(folder))
        if scenario == "slow reader":
            reader = slow_reader()
            stack.callback(reader.kill)
        for key in keys:
            rng, took = Random(key), None
            while took is None:
                took = Opening(nodes, scenario, rng).run()
            yield key, took
