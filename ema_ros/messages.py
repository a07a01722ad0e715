"""Between our types and those of the client library, for all nodes: topics and status.

What of the client library is not its public interface is used here and nowhere else:
`PolledGroup`, `read_message`, `refuse_wrong_transitions`, `take_all`, `try_publish`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from typing import Any, NamedTuple, TypeVar

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from ema_record.wire.topics import BIT_RECORD, DIAGNOSTICS, TOPICS, Qos, relative_name
from ema_record.wire.types import NANOSECONDS

T = TypeVar("T")
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

POLLED_DEPTH = 100
"""Messages that may come between two looks: an interlock that opens for a moment is one."""


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
    """Return a publisher of a topic of the table, in the namespace of the node."""
    return node.create_publisher(
        message_class(topic), relative_name(topic), qos_profile(TOPICS[topic].qos)
    )


def make_subscription(
    node: Node, topic: str, callback: Callable[[Any], None], *, raw: bool = False
) -> Subscription:
    """Return a subscription to a topic of the table; `raw` gives serialised messages."""
    return node.create_subscription(
        message_class(topic), relative_name(topic), callback, qos_profile(TOPICS[topic].qos),
        raw=raw,
    )


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
        message_class(topic), relative_name(topic), _never_called, qos_profile(wanted), raw=True,
        callback_group=group,
    )


def refuse_wrong_transitions(node: LifecycleNode) -> None:
    """Have a request for a transition that the state of a node does not allow answered by no.

    The client library raises, which ends the process and leaves the caller without an answer.
    """
    service = next(s for s in node.services if s.srv_name.endswith("change_state"))
    respond = service.callback

    def answered(request: Any, response: Any) -> Any:
        try:
            return respond(request, response)
        except rclpy_implementation.RCLError:
            response.success = False
            return response

    service.callback = answered


def unheard(node: Node, subscription: Subscription) -> str:
    """Return that somebody publishes what a subscription does not get; empty: nobody does."""
    name = subscription.topic_name
    if subscription.get_publisher_count() or not node.count_publishers(name):
        return ""
    wanted = subscription.qos_profile
    latched = wanted.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return f" ({name} is published, but not {'latched and ' if latched else ''}reliably)"


def resolved(node: Node, topic: str) -> str:
    """Return the name of a topic of the table on the graph, as this node knows it."""
    name: str = node.resolve_topic_name(relative_name(topic))
    return name


def monitors(node: Node) -> list[str]:
    """Return the services of the monitors that are active: who announces records, and tests."""
    found = {node.resolve_service_name("~/self_test")}
    for publisher in node.get_publishers_info_by_topic(resolved(node, BIT_RECORD)):
        found.add(f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}/self_test")
    return [service for service in sorted(found) for _ in range(node.count_services(service))]


def namespace_of(node: Node) -> str:
    """Return the namespace of a node with its slash, empty for the root."""
    name: str = node.get_namespace()
    return name.rstrip("/")


def status_name(node: Node, task: str) -> str:
    """Return the name of a diagnostic status: ``ema_monitor: test``, below its namespace."""
    namespace = namespace_of(node)
    return f"{namespace + '/' if namespace else ''}{node.get_name()}: {task}"


def make_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Return a timer (s) that a step of the host's clock neither stops nor hurries."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


def set_period(timer: Timer, period: float) -> None:
    """Let a timer go at another period (s), from now on."""
    if timer.timer_period_ns != round(period * NANOSECONDS):
        timer.timer_period_ns = round(period * NANOSECONDS)
        timer.reset()


def try_publish(publisher: Publisher, message: Any) -> bool:
    """Publish, or return False: the history of a slow reader stayed full (10 ms)."""
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


def read_message(data: bytes, kind: type[T]) -> T | None:
    """Return the message of a kind that CDR holds, None where it is damaged.

    Anybody on the domain may send anything, and what is polled is not looked at before.
    """
    try:
        found: T = deserialize_message(data, kind)
    except rclpy_implementation.RMWError:
        return None
    return found


def diagnostic_status(
    name: str, level: bytes, message: str, values: Mapping[str, str], hardware_id: str = ""
) -> DiagnosticStatus:
    """Return one diagnostic status."""
    return DiagnosticStatus(
        name=name, level=level, message=message, hardware_id=hardware_id,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a diagnostic status by their keys."""
    return {pair.key: pair.value for pair in status.values}


def stamp_message(stamp: int) -> Time:
    """Return ns since the epoch as the time of a header."""
    return Time(sec=stamp // NANOSECONDS, nanosec=stamp % NANOSECONDS)


class DiagnosticsPublisher:
    """Publishes `/diagnostics` for one node, stamped by the host's clock as all else."""

    def __init__(self, node: Node) -> None:
        self._publisher = make_publisher(node, DIAGNOSTICS)
        self._readers = 0

    def has_new_reader(self) -> bool:
        """Return whether somebody listens who did not at the last call."""
        before, self._readers = self._readers, self._publisher.get_subscription_count()
        return bool(self._readers > before)

    def publish(self, *statuses: DiagnosticStatus) -> None:
        """Publish statuses with the time of now."""
        array = DiagnosticArray(status=list(statuses))
        array.header.stamp = stamp_message(time.time_ns())
        self._publisher.publish(array)
