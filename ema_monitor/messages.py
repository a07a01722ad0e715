"""Between the types of the built-in test and those of the client library."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from diagnostic_msgs.srv import SelfTest
from geometry_msgs.msg import Vector3Stamped
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import BatteryState, JointState, Temperature
from std_msgs.msg import Bool, Float64, Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

from ema_monitor.checks import CheckResult, Level
from ema_monitor.sequence import ActuatorStatus
from ema_record.node_parameters import ParameterSpec, Value, check_values
from ema_record.topics import TOPICS, Qos

_CLASSES: dict[str, Any] = {
    "std_msgs/msg/Float64MultiArray": Float64MultiArray,
    "sensor_msgs/msg/JointState": JointState,
    "geometry_msgs/msg/Vector3Stamped": Vector3Stamped,
    "sensor_msgs/msg/BatteryState": BatteryState,
    "sensor_msgs/msg/Temperature": Temperature,
    "trajectory_msgs/msg/JointTrajectory": JointTrajectory,
    "std_msgs/msg/Bool": Bool,
    "std_msgs/msg/String": String,
    "std_msgs/msg/Float64": Float64,
    "diagnostic_msgs/msg/DiagnosticStatus": DiagnosticStatus,
    "diagnostic_msgs/msg/DiagnosticArray": DiagnosticArray,
}

ACTUATOR_STATUS = "ema_sim: actuator"
"""Name of the status in which the actuator reports."""
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


class Taken(NamedTuple):
    """One serialised message as it arrived."""

    data: bytes
    received: int
    """Ns since the epoch."""
    sent: int
    """Ns since the epoch, by the clock of the source."""


def qos_profile(qos: Qos) -> QoSProfile:
    """Return the quality of service in the form of the client library."""
    return QoSProfile(
        history=HistoryPolicy.get_from_short_key(qos.history),
        depth=qos.depth,
        reliability=ReliabilityPolicy.get_from_short_key(qos.reliability),
        durability=DurabilityPolicy.get_from_short_key(qos.durability),
    )


def make_publisher(node: Node, topic: str) -> Publisher:
    """Return a publisher of a topic of the table."""
    entry = TOPICS[topic]
    return node.create_publisher(_CLASSES[entry.type], topic, qos_profile(entry.qos))


def _never_called(_: bytes) -> None:
    """Stand for the callback of a polled subscription."""


def make_polled_subscription(node: Node, topic: str, group: PolledGroup) -> Subscription:
    """Return a subscription to serialised messages of a topic of the table."""
    entry = TOPICS[topic]
    return node.create_subscription(
        _CLASSES[entry.type], topic, _never_called, qos_profile(entry.qos), raw=True,
        callback_group=group,
    )


def take_all(subscription: Subscription) -> list[Taken]:
    """Return all messages that wait."""
    found: list[Taken] = []
    with subscription.handle:
        while True:
            taken = subscription.handle.take_message(subscription.msg_type, True)
            if taken is None:
                return found
            info = taken[1]
            found.append(Taken(taken[0], info["received_timestamp"], info["source_timestamp"]))


def declare_parameters(node: Node, specs: Iterable[ParameterSpec]) -> dict[str, Value]:
    """Declare all parameters of a node, read-only, and return their values.

    Raises
    ------
    UsageError
        An unknown name or a wrong value was given to the node.
    """
    specs = list(specs)
    overrides = node._parameter_overrides  # noqa: SLF001  (the only way to see unknown names)
    given = {name: parameter.value for name, parameter in overrides.items()}
    values = check_values(specs, given)
    for spec in specs:
        descriptor = ParameterDescriptor(description=spec.description, read_only=True)
        if spec.lower is not None and spec.upper is not None:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(spec.lower), to_value=float(spec.upper))
            ]
        node.declare_parameter(spec.name, values[spec.name], descriptor, ignore_override=True)
    return values


def diagnostic_status(
    name: str, level: Level, message: str, values: Mapping[str, str], hardware_id: str = ""
) -> DiagnosticStatus:
    """Return one diagnostic status."""
    return DiagnosticStatus(
        name=name, level=_LEVELS[level], message=message, hardware_id=hardware_id,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def check_status(result: CheckResult) -> DiagnosticStatus:
    """Return the result of a record check as a diagnostic status."""
    return diagnostic_status(
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
    """Return what the actuator says of itself and its serial number, if it is in the array."""
    for status in array.status:
        if status.name != ACTUATOR_STATUS:
            continue
        values = {pair.key: pair.value for pair in status.values}
        try:
            return ActuatorStatus(
                active=values["state"] != "idle",
                surface_position=float(values["surface_position"]),
                command_stamp=int(values["command_stamp"]),
                start_time=int(values["start_time"]),
                samples_published=int(values["samples_published"]),
            ), status.hardware_id
        except (KeyError, ValueError):
            return None
    return None
