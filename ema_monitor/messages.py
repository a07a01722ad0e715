"""Between the types of the built-in test and those of the client library."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from diagnostic_msgs.srv import SelfTest
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.task import Future

from ema_monitor.observation import ActuatorStatus
from ema_record.bag.annotate import add_last_message
from ema_record.checks.live import CheckResult, Level
from ema_record.errors import EmaError
from ema_record.wire.topics import (
    BAG_TOPICS,
    DIAGNOSTICS,
    TOPICS,
    VERDICT,
    WEIGHT_ON_WHEELS,
    name_on_graph,
)
from ema_record.wire.types import is_stamp
from ema_ros.messages import (
    PolledGroup,
    diagnostic_status,
    make_polled_subscription,
    monitors,
    namespace_of,
    read_message,
    take_all,
    unheard,
    values_of,
)

READ = tuple(sorted((*(topic.name for topic in BAG_TOPICS), DIAGNOSTICS),
                    key=lambda topic: topic != WEIGHT_ON_WHEELS))
"""Topics that the monitor reads, what may abort a test first."""
VERDICT_WAIT = 0.3
"""Longest wait, at the end, for the verdict on the last record (s)."""
ACTUATOR_STATUS = "actuator"
"""Name of the status in which an actuator reports."""
ACTUATOR_KEYS = {
    "state": "'idle', or anything else while a command is executed",
    "surface_position": "of the surface, as measured (rad)",
    "command_stamp": "header stamp of the command accepted last (ns since the epoch), 0 without",
    "start_time": "when it was accepted (ns since the epoch): time 0 of its samples",
    "samples_published": "how many samples answer it so far",
}
"""What that status must say."""
ACQUISITION, CAPTURE = "acquisition", "capture"
"""What it may say besides: the samples of a move come when it is over."""


class Request:
    """A caller of the service, waiting for the end of its test."""

    def __init__(self) -> None:
        self.asked = time.monotonic()
        self.ended = Future()
        """Its result: why the test did not run to its end; empty: it did."""
        self.statuses: list[DiagnosticStatus] = []
        self.passed = False


def refuse(waiting: list[Request], reason: str) -> bool:
    """Answer all who wait for a test to begin; return whether somebody did."""
    some = bool(waiting)
    while waiting:
        waiting.pop().ended.set_result(reason)
    return some


def level_status(
    name: str, level: Level, message: str, values: Mapping[str, str], hardware_id: str = ""
) -> DiagnosticStatus:
    """Return one diagnostic status of a level of the record checks."""
    return diagnostic_status(name, bytes([level]), message, values, hardware_id)


class VerdictKeeper:
    """Adds the verdict on the last record to it, when it comes.

    Parameters
    ----------
    node : hears it.
    wanted : whether it is added.
    """

    def __init__(self, node: Node, group: PolledGroup, *, wanted: bool) -> None:
        self._logger = node.get_logger()
        self.subscription = make_polled_subscription(node, VERDICT, group)
        self._topic = replace(
            TOPICS[VERDICT], name=name_on_graph(VERDICT, namespace_of(node)))
        self._wanted = wanted
        self._awaited: Path | None = None

    def expect(self, path: Path) -> None:
        """Take the record that the next verdict is of."""
        if self._awaited is not None:
            self._logger.warning(f"{self._awaited}: no verdict came: judge it by 'ema check'")
        self._awaited = path.resolve() if self._wanted else None

    def poll(self) -> None:
        """Take verdicts that have come."""
        for taken in take_all(self.subscription):
            status = read_message(taken.data, DiagnosticStatus) or DiagnosticStatus()
            said = values_of(status)
            path = self._awaited
            if path is None or said.get("bag") != str(path):
                continue
            self._awaited = None
            try:
                add_last_message(path, self._topic, taken.data, time.time_ns(), {
                    key: said[key] for key in ("verdict", "fault_code") if key in said},
                    said.get("json", "").encode())
            except EmaError as error:
                self._logger.warning(f"verdict not added to the record: {error}")

    def wait(self) -> None:
        """Wait a little for a verdict that has not come, if somebody is there who gives it."""
        end = time.monotonic() + VERDICT_WAIT
        while (self._awaited is not None and self.subscription.get_publisher_count() > 0
               and time.monotonic() < end):
            self.poll()
            time.sleep(0.01)


def what_is_missing(
    node: Node, samples: Subscription, command: Publisher, reported: Sequence[str],
) -> str:
    """Return what of the graph is missing or in the way; empty: nothing.

    `reported` : serial numbers that call themselves its actuator.
    """
    publishers = samples.get_publisher_count()
    if publishers != 1:
        return (f"{publishers} nodes publish {samples.topic_name}, expected one actuator"
                f"{unheard(node, samples)}")
    if command.get_subscription_count() < 1:
        return f"no actuator listens to {command.topic_name}"
    own = node.resolve_service_name("~/self_test")
    if len(found := monitors(node)) > 1:
        other = next((service for service in found if service != own), own)
        return f"another monitor offers {other} on this domain"
    if len(reported) > 1:
        return f"{len(reported)} actuators report here: {', '.join(reported)}"
    return ""


def record_statuses(
    path: Path, status: str, closed: int, results: Sequence[CheckResult]
) -> list[DiagnosticStatus]:
    """Return what the answer of the self-test says of its record and of each check.

    Parameters
    ----------
    path : of the bag.
    status : how the test ended.
    closed : when the bag was closed (ns since the epoch).
    results : of the record checks; empty: it is not complete.
    """
    return [
        level_status(
            "ema_monitor: record", Level.OK if results else Level.ERROR, status,
            {"path": str(path.resolve()), "status": status, "closed": str(closed)},
        ),
        *(level_status(f"ema_monitor: {result.name}", result.level, result.message, result.values)
          for result in results),
    ]


def fill_response(
    response: SelfTest.Response, serial: str, request: Request, reason: str
) -> SelfTest.Response:
    """Fill in the answer of the self-test service; `reason` says why it did not end."""
    passed = request.passed
    outcome = level_status(
        "ema_monitor: test", Level.OK if passed else Level.ERROR,
        reason or ("passed" if passed else "record checks failed"), {},
    )
    response.id = serial
    response.passed = b"\x01" if passed else b"\x00"
    response.status = [outcome, *request.statuses]
    return response


def find_actuator(
    array: DiagnosticArray | None, namespace: str
) -> tuple[ActuatorStatus, str] | None:
    """Return what the actuator says of itself and its serial number, if it is in the array.

    Any driver may take the place of the emulated actuator. Its DiagnosticStatus is named
    ``actuator`` or ``<node>: actuator``, both below the namespace if it has one
    (``/left_aileron/driver: actuator``); its hardware_id is the actuator's serial number. It
    comes at least once a second, and at the begin and the end of each run, with the keys of
    `ACTUATOR_KEYS`. Others may stand beside them.
    """
    for status in () if array is None else array.status:
        if not reports_of(status.name, namespace):
            continue
        try:
            wrong = status.message if status.level > DiagnosticStatus.OK else ""
            return actuator_status(values_of(status), wrong), status.hardware_id
        except (KeyError, ValueError):  # a status of somebody else, of the same name
            continue
    return None


def reports_of(name: str, namespace: str) -> bool:
    """Return whether a status of this name is of the actuator in a namespace."""
    node, _, task = name.rpartition(": ")
    path = node.rpartition("/")[0] if node else name.rpartition("/")[0]
    task = task if node else name.rpartition("/")[2]
    return task == ACTUATOR_STATUS and path.strip("/") == namespace.strip("/")


def actuator_status(values: Mapping[str, str], complaint: str = "") -> ActuatorStatus:
    """Return a status of the actuator (KeyError: incomplete; ValueError: no number)."""
    position = float(values["surface_position"])
    if not math.isfinite(position):
        raise ValueError(f"surface_position {position}")
    if not is_stamp(start := int(values["start_time"])):
        raise ValueError(f"start_time {start}")
    return ActuatorStatus(
        active=values["state"] != "idle", surface_position=position,
        command_stamp=int(values["command_stamp"]), start_time=start,
        samples_published=int(values["samples_published"]),
        captures=values.get(ACQUISITION) == CAPTURE, complaint=complaint,
    )
