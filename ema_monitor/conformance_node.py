"""The node `ema_conformance`: listens to a driver, commands it to stay, and plays the aircraft."""

from __future__ import annotations

import time
from collections.abc import Callable

import rclpy
import rclpy.executors
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool, Header

from ema_monitor.conformance import FOLLOWED, PUBLISHED, DriverRun, Endpoint, Heard
from ema_monitor.messages import (
    ACQUISITION,
    ACTUATOR_KEYS,
    ACTUATOR_STATUS,
    CAPTURE,
    actuator_status,
    reports_of,
)
from ema_record.errors import InvalidRecordError, TestRefusedError
from ema_record.profile import load_profile_dict
from ema_record.wire.samples import decode_block
from ema_record.wire.topics import COMMAND, DC_BUS, DEADMAN, DIAGNOSTICS, SAMPLES, WEIGHT_ON_WHEELS
from ema_record.wire.trajectory import encode_command
from ema_record.wire.types import NANOSECONDS, stamp_of
from ema_ros.messages import (
    PolledGroup,
    make_polled_subscription,
    make_publisher,
    make_timer,
    read_message,
    resolved,
    stamp_message,
    take_all,
    values_of,
)
from ema_ros.process import spun

NODE_NAME = "ema_conformance"
SPIN = 0.02
PERIOD = 0.1
"""Interval of weight on wheels (s)."""
LISTEN = 2.5
"""Time for which the status is listened to (s)."""
HOLD = 0.5
"""Duration of the command to stay (s)."""
OBEY = 1.0
"""Time in which a driver accepts a command (s)."""
END = 6.0
"""Time in which a run is over and its samples have arrived, beyond its duration (s)."""


class ConformanceNode(Node):
    """Runs one driver through its contract."""

    def __init__(self, context: rclpy.Context, namespace: str) -> None:
        """Appear on the graph, off the wheels."""
        super().__init__(NODE_NAME, context=context, namespace=namespace)
        self.heard = Heard(namespace)
        self._on_wheels = False
        self._run: DriverRun | None = None
        self._last_status = 0.0
        group = PolledGroup()
        self._polled = {topic: make_polled_subscription(self, topic, group)
                        for topic in (SAMPLES, DIAGNOSTICS, DC_BUS)}
        self._wheels = make_publisher(self, WEIGHT_ON_WHEELS)
        self._command = make_publisher(self, COMMAND)
        self._deadman = make_publisher(self, DEADMAN)
        make_timer(self, PERIOD, self._on_timer)

    def _on_timer(self) -> None:
        self._send_wheels(self._on_wheels)
        if self._run is not None:
            self._deadman.publish(Header(stamp=stamp_message(self._run.stamp)))

    def _send_wheels(self, on_wheels: bool) -> None:
        self._on_wheels = on_wheels
        self._wheels.publish(Bool(data=on_wheels))

    def examine(self, wait: float) -> Heard:
        """Return what was heard; a driver is waited for `wait` (s).

        Raises
        ------
        TestRefusedError
            There is none, or it executes somebody's command.
        """
        found = self._spin_until(
            lambda: self.count_publishers(resolved(self, SAMPLES)) > 0, wait)
        if not found:
            raise TestRefusedError(
                f"no node publishes {resolved(self, SAMPLES)} after {wait:g} s: start the driver "
                "in this ROS_DOMAIN_ID, or give its --namespace"
            )
        self._spin_until(lambda: False, LISTEN)
        self._look_at_the_graph()
        if self.heard.problem:
            return self.heard
        if self.heard.values["state"] != "idle":
            raise TestRefusedError(
                f"the driver's state is {self.heard.values['state'][:40]!r}: wait until it is "
                "idle")
        alone = self.count_publishers(resolved(self, WEIGHT_ON_WHEELS)) <= 1
        if alone:
            self.heard.refused = self._command_to_stay(on_wheels=False)
        self.heard.held = self._command_to_stay(on_wheels=True)
        if alone and self._accepted(self.heard.held):
            self.heard.stopped = self._command_to_stay(on_wheels=True, open_after=0.3)
        return self.heard

    def _look_at_the_graph(self) -> None:
        """Note who publishes and subscribes what, this node left out."""
        for topics, ask, place in (
            ((SAMPLES, *PUBLISHED), self.get_publishers_info_by_topic, self.heard.publishers),
            (FOLLOWED, self.get_subscriptions_info_by_topic, self.heard.subscribers),
        ):
            drivers = {end.node for end in self.heard.publishers.get(SAMPLES, [])}
            for topic in topics:
                ends = [
                    Endpoint(info.node_name, info.topic_type,
                             info.qos_profile.reliability == ReliabilityPolicy.RELIABLE)
                    for info in ask(resolved(self, topic)) if info.node_name != NODE_NAME
                ]
                followed = topics is FOLLOWED
                place[topic] = [e for e in ends if e.node in drivers] if followed else ends

    def _command_to_stay(self, *, on_wheels: bool, open_after: float | None = None) -> DriverRun:
        """Command the surface to be where it is, and return what followed.

        Parameters
        ----------
        on_wheels : what is said of the aircraft.
        open_after : when weight on wheels ends (s after the samples began); None: it does not.
        """
        self._send_wheels(on_wheels)
        self._spin_until(lambda: False, 0.5)
        at = float(self.heard.values["surface_position"])
        duration = HOLD if open_after is None else 10.0 * HOLD
        hold = load_profile_dict({"name": "stay", "points": [[0.0, at], [duration, at]]}, "stay")
        run = DriverRun(stamp=time.time_ns(), sent=time.time_ns(), duration=duration)
        self._run = run
        self._command.publish(encode_command(hold, run.stamp))
        if self._spin_until(lambda: self._accepted(run), OBEY if on_wheels else 0.5):
            if open_after is not None:
                if self.heard.values.get(ACQUISITION) != CAPTURE:
                    self._spin_until(lambda: bool(run.blocks), END)
                self._spin_until(lambda: False, open_after)
                run.opened = time.monotonic()
                self._send_wheels(False)
            self._spin_until(lambda: self._over(run), duration + END)
        self._run = None
        return run

    def _accepted(self, run: DriverRun) -> bool:
        return any(status["command_stamp"] == str(run.stamp) for status in run.statuses)

    def _over(self, run: DriverRun) -> bool:
        """Whether the driver is idle again and all that it counts has arrived."""
        last = run.statuses[-1]
        if last["state"] != "idle" or last["command_stamp"] != str(run.stamp):
            return False
        if run.opened is not None:
            return True
        return sum(map(len, run.blocks)) >= int(last["samples_published"]) > 0

    def _spin_until(self, condition: Callable[[], bool], limit: float) -> bool:
        """Spin until a condition holds; return whether it does within `limit` (s)."""
        end = time.monotonic() + limit
        assert self.executor is not None
        while not condition():
            if time.monotonic() > end:
                return False
            self.executor.spin_once(timeout_sec=SPIN)
            self._listen()
        return True

    def _listen(self) -> None:
        for taken in take_all(self._polled[DC_BUS]):
            message = read_message(taken.data, BatteryState)
            if message is not None:
                self.heard.bus = float(message.voltage), float(message.current)
        for taken in take_all(self._polled[SAMPLES]):
            if self._run is not None:
                try:
                    self._run.blocks.append(decode_block(taken.data))
                except InvalidRecordError as error:
                    self._run.errors.append(str(error))
        for taken in take_all(self._polled[DIAGNOSTICS]):
            self._take_status(read_message(taken.data, DiagnosticArray) or DiagnosticArray())

    def _take_status(self, array: DiagnosticArray) -> None:
        heard, now = self.heard, time.monotonic()
        for status in array.status:
            if not reports_of(status.name, heard.namespace):
                if ACTUATOR_STATUS in status.name:
                    heard.names.append(status.name)
                continue
            values = values_of(status)
            absent = [key for key in ACTUATOR_KEYS if key not in values]
            try:
                heard.problem = f"it lacks {', '.join(absent)}" if absent else ""
                if not absent:
                    actuator_status(values)
            except ValueError as error:
                heard.problem = f"a number is none: {error}"
            if heard.problem:
                continue
            if self._last_status and self._run is None and heard.held is None:
                heard.gaps.append(now - self._last_status)
            self._last_status = now
            heard.values, heard.hardware_id = values, status.hardware_id
            heard.skew = (stamp_of(array) - time.time_ns()) / NANOSECONDS
            run = self._run
            if run is not None:
                run.statuses.append({**values, "message": status.message})
                if run.opened is not None and run.idle is None and values["state"] == "idle":
                    run.idle = now


def examine(namespace: str, wait: float) -> Heard:
    """Return what was heard of the driver in a namespace (TestRefusedError: there is none)."""
    with spun(rclpy, lambda context: [ConformanceNode(context, namespace)]) as (node,):
        return node.examine(wait)
