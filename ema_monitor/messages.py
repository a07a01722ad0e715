"""Between the types of the built-in test and those of the client library."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from diagnostic_msgs.srv import SelfTest
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.subscription import Subscription

from ema_monitor.sequence import ActuatorStatus
from ema_record.checks.live import CheckResult, Level
from ema_record.wire.topics import TOPICS
from ema_ros.messages import Taken, diagnostic_status, message_class, qos_profile

ACTUATOR_STATUS = ": actuator"
"""End of the name of the status in which an actuator reports."""
POLLED_DEPTH = 100
"""Messages that may come between two looks: an interlock that opens for a moment is one."""
_LEVELS = {
    Level.OK: DiagnosticStatus.OK,
    Level.WARN: DiagnosticStatus.WARN,
    Level.ERROR: DiagnosticStatus.ERROR,
}


class PolledGroup(CallbackGroup):
    """Group of subscriptions that never wake the executor; `take_all` empties them.

    Four thousand messages a second cost a few percent of a core this way.
    """

    def can_execute(self, entity: Any) -> bool:  # noqa: ARG002  (the base class's signature)
        """Never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:  # noqa: ARG002
        """Never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing begins, so nothing ends."""


def _never_called(_: bytes) -> None:
    """Stand for the callback of a polled subscription."""


def make_polled_subscription(node: Node, topic: str, group: PolledGroup) -> Subscription:
    """Return a subscription to serialised messages of a topic of the table."""
    offered = TOPICS[topic].qos
    wanted = replace(offered, depth=max(offered.depth, POLLED_DEPTH))
    return node.create_subscription(
        message_class(topic), topic, _never_called, qos_profile(wanted), raw=True,
        callback_group=group,
    )


def in_order(messages: list[Taken]) -> list[Taken]:
    """Return messages of one publisher as it sent them.

    The middleware hands over those that wait by the time of their source, which is another
    order where its clock was set back.
    """
    return sorted(messages, key=lambda message: message.sequence)


def level_status(
    name: str, level: Level, message: str, values: Mapping[str, str], hardware_id: str = ""
) -> DiagnosticStatus:
    """Return one diagnostic status of a level of the record checks."""
    return diagnostic_status(name, _LEVELS[level], message, values, hardware_id)


def check_status(result: CheckResult) -> DiagnosticStatus:
    """Return the result of a record check as a diagnostic status."""
    return level_status(
        f"ema_monitor: {result.name}", result.level, result.message, result.values
    )


def fill_response(
    response: SelfTest.Response, serial: str, passed: bool, statuses: list[DiagnosticStatus]
) -> SelfTest.Response:
    """Fill in the answer of the self-test service."""
    response.id = serial
    response.passed = b"\x01" if passed else b"\x00"
    response.status = statuses
    return response


def find_actuator(array: DiagnosticArray) -> tuple[ActuatorStatus, str] | None:
    """Return what the actuator says of itself and its serial number, if it is in the array.

    Any driver may take the place of the emulated actuator. Its DiagnosticStatus is named
    ``<anything>: actuator``, its hardware_id is the actuator's serial number. It comes at least
    once a second, and at the begin and the end of each run, with these five keys (others may
    stand beside them):

    state : ``idle``, anything else while a command is being executed.
    surface_position : of the surface, as measured (rad).
    command_stamp : header stamp of the JointTrajectory that was accepted last (ns since the
        epoch), 0 before the first one.
    start_time : when it was accepted (ns since the epoch): time 0 of its samples.
    samples_published : how many samples on `/ema/samples` answer it so far.
    """
    for status in array.status:
        if not status.name.endswith(ACTUATOR_STATUS):
            continue
        values = {pair.key: pair.value for pair in status.values}
        try:
            found = ActuatorStatus(
                active=values["state"] != "idle",
                surface_position=float(values["surface_position"]),
                command_stamp=int(values["command_stamp"]),
                start_time=int(values["start_time"]),
                samples_published=int(values["samples_published"]),
            )
        except (KeyError, ValueError):  # a status of somebody else, of the same name
            continue
        if math.isfinite(found.surface_position):
            return found, status.hardware_id
    return None
