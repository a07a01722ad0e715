"""Standard ROS 2 messages without ROS: types and CDR by `rosbags`, ours read by `definitions`."""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING, Any

from ema_record.errors import InvalidRecordError
from ema_record.limits import MAX_SMALL_MESSAGE_BYTES
from ema_record.wire.definitions import DEFINITIONS, decode

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

NANOSECONDS = 1_000_000_000
SCHEMA_ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"


@cache
def typestore() -> Typestore:
    """Return all types of ROS 2 Jazzy; 0.1 s the first time."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


@cache
def _own() -> Typestore:
    """Return a store for the types of `DEFINITIONS` that are asked for."""
    from rosbags.typesys.store import Typestore

    return Typestore()


@cache
def _store_of(message_type: str) -> Typestore:
    """Return a store that holds a type and those that it uses."""
    if message_type not in DEFINITIONS:
        return typestore()
    from rosbags.typesys import get_types_from_msg

    found: dict[str, Any] = {}
    waiting = [message_type]
    while waiting:
        name = waiting.pop()
        found |= get_types_from_msg(DEFINITIONS[name], name)
        waiting += [f"{package}/msg/{used}" for package, used in
                    re.findall(r"^(\w+)/(\w+)", DEFINITIONS[name], re.MULTILINE)]
    _own().register(found)
    return _own()


@cache
def definition(message_type: str) -> str:
    """Return the definition of a type, those of the types that it uses joined to it."""
    text, _ = _store_of(message_type).generate_msgdef(message_type, ros_version=2)
    return text


@cache
def type_hash(message_type: str) -> str:
    """Return the RIHS01 hash of a type (REP 2011)."""
    return _store_of(message_type).hash_rihs01(message_type)


def message_class(message_type: str) -> Any:
    """Return the class of a message type such as ``std_msgs/msg/Bool``."""
    return _store_of(message_type).types[message_type]


def header(stamp: int) -> Any:
    """Return a std_msgs/Header with `stamp` (ns since the epoch)."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    time = message_class("builtin_interfaces/msg/Time")(sec=seconds, nanosec=nanoseconds)
    return message_class("std_msgs/msg/Header")(stamp=time, frame_id="")


def is_stamp(stamp: int) -> bool:
    """Whether a message can hold a time (ns since the epoch): seconds have 32 bits, till 2038."""
    return 0 <= stamp < 2**31 * NANOSECONDS


def stamp_of(message: Any) -> int:
    """Return the stamp of a message's header, or of a header itself (ns since the epoch)."""
    stamp = getattr(message, "header", message).stamp
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def serialize(message: Any, message_type: str) -> bytes:
    """Return a message as CDR with its encapsulation."""
    return bytes(_store_of(message_type).serialize_cdr(message, message_type))


def deserialize(data: bytes | memoryview, message_type: str, topic: str) -> Any:
    """Return the message of a type of `DEFINITIONS` that CDR holds; `topic` is named in errors.

    Bytes after the message are ignored: rclpy's ``serialize_message`` leaves some behind
    wherever a sequence of doubles is empty.

    Raises
    ------
    InvalidRecordError
        The message is damaged, or larger than `limits.MAX_SMALL_MESSAGE_BYTES`.
    """
    if len(data) > MAX_SMALL_MESSAGE_BYTES:
        raise InvalidRecordError(
            f"{topic}: message of {len(data)} bytes, at most {MAX_SMALL_MESSAGE_BYTES}: "
            f"it is no {message_type} of an actuator test"
        )
    try:
        return decode(data, message_type)
    except Exception as error:  # noqa: BLE001  (decoders raise what numpy and struct raise)
        detail = (str(error).splitlines() or [""])[0][:80] or type(error).__name__
        raise InvalidRecordError(
            f"{topic}: {len(data)} bytes are no {message_type} ({detail}): the message is damaged"
        ) from None
