"""Between our types and those of the client library, for all nodes: topics, parameters, status."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from ema_record.errors import EmaError, UsageError
from ema_record.kit import use_kit
from ema_record.wire.topics import DIAGNOSTICS, TOPICS, Qos
from ema_ros.parameters import KIT, USE_SIM_TIME, ParameterSpec, Value, check_values
from ema_ros.process import StopSignal

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def message_class(topic: str) -> Any:
    """Return the class of the messages of a topic of the table."""
    package, kind, name = TOPICS[topic].type.split("/")
    return getattr(import_module(f"{package}.{kind}"), name)


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
    return node.create_publisher(message_class(topic), topic, qos_profile(TOPICS[topic].qos))


def make_subscription(
    node: Node, topic: str, callback: Callable[[Any], None], *, raw: bool = False
) -> Subscription:
    """Return a subscription to a topic of the table; `raw` gives serialised messages."""
    return node.create_subscription(
        message_class(topic), topic, callback, qos_profile(TOPICS[topic].qos), raw=raw
    )


def make_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Return a timer (s) that a step of the host's clock neither stops nor hurries."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


def try_publish(publisher: Publisher, message: Any) -> bool:
    """Publish, or return False: the history of a slow reader stayed full (100 ms)."""
    try:
        publisher.publish(message)
    except rclpy_implementation.RCLError:
        return False
    return True


class Taken(NamedTuple):
    """One serialised message as it arrived."""

    data: bytes
    received: int
    """Ns since the epoch."""
    sent: int
    """Ns since the epoch, by the clock of the source."""
    sequence: int
    """Number of the message, as its publisher counts."""


def take_all(subscription: Subscription) -> list[Taken]:
    """Return all messages that wait, faster than a callback each."""
    found: list[Taken] = []
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
            data, info = taken
            found.append(Taken(
                data, info["received_timestamp"], info["source_timestamp"],
                info["publication_sequence_number"] or 0,
            ))
    return found


class EmaNode(Node):
    """A node that `node_process.run_node` can run, with all the parameters that it was given.

    Parameters
    ----------
    name : of the node.
    stop : tells that the process was asked to end.

    Raises
    ------
    UsageError
        A parameter was given without a value.
    """

    def __init__(self, name: str, stop: StopSignal) -> None:
        """Appear on the graph."""
        try:
            super().__init__(name, automatically_declare_parameters_from_overrides=True)
        except ValueError:
            raise UsageError(
                "a parameter has no value, or an empty list for one: give NAME:=VALUE"
            ) from None
        self.exit_status: int | None = None
        """Set: the process is to end with this status."""
        self._stop = stop


def use_given_kit(node: Node) -> None:
    """Work with the kit that the node's parameter `KIT` names, if it does.

    Raises
    ------
    UsageError
        There is no such kit.
    """
    use_kit(str(KIT.check(given_parameters(node).get(KIT.name, KIT.default))))


def declare_parameters(node: Node, specs: Iterable[ParameterSpec]) -> dict[str, Value]:
    """Declare all parameters of a node with their bounds and return their values.

    Raises
    ------
    UsageError
        A name or a value given to the node is wrong.
    """
    specs = list(specs)
    given = given_parameters(node)
    values = check_values(specs, given)
    fixed = ParameterDescriptor(type=ParameterType.PARAMETER_BOOL, read_only=True)
    node.set_descriptor(USE_SIM_TIME, fixed)
    for spec in specs:
        if spec.name in given:  # declared by the node itself, without bounds
            node.undeclare_parameter(spec.name)
        node.declare_parameter(
            spec.name, values[spec.name], _descriptor(spec), ignore_override=True
        )
    return values


def given_parameters(node: Node) -> dict[str, Any]:
    """Return the parameters that an `EmaNode` was given or has declared, known or not."""
    return {name: node.get_parameter(name).value for name in node.get_parameters_by_prefix("")}


def on_parameters(
    node: Node, specs: Iterable[ParameterSpec], apply: Callable[[dict[str, Value]], None]
) -> None:
    """Call `apply` with checked new values; an EmaError that it raises refuses them."""
    known = {spec.name: spec for spec in specs}

    def callback(parameters: list[Parameter]) -> SetParametersResult:
        try:
            apply({p.name: known[p.name].check(p.value) for p in parameters if p.name in known})
        except EmaError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(callback)


def _descriptor(spec: ParameterSpec) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=spec.description, read_only=spec.read_only)
    descriptor.additional_constraints = (
        f"one of {', '.join(spec.options)}" if spec.options else ""
    )
    if spec.lower is None or spec.upper is None:
        return descriptor
    if isinstance(spec.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(spec.lower), to_value=float(spec.upper))
        ]
    else:
        descriptor.integer_range = [
            IntegerRange(from_value=int(spec.lower), to_value=int(spec.upper), step=1)
        ]
    return descriptor


def diagnostic_status(
    name: str, level: bytes, message: str, values: Mapping[str, str], hardware_id: str = ""
) -> DiagnosticStatus:
    """Return one diagnostic status."""
    return DiagnosticStatus(
        name=name, level=level, message=message, hardware_id=hardware_id,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


class DiagnosticsPublisher:
    """Publishes `/diagnostics` for one node."""

    def __init__(self, node: Node) -> None:
        """Make the publisher."""
        self._clock = node.get_clock()
        self._publisher = make_publisher(node, DIAGNOSTICS)

    def publish(self, *statuses: DiagnosticStatus) -> None:
        """Publish statuses with the time of now."""
        array = DiagnosticArray(status=list(statuses))
        array.header.stamp = self._clock.now().to_msg()
        self._publisher.publish(array)
