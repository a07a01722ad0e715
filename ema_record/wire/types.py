"""Standard ROS 2 messages without ROS: definitions, CDR.

They are written by the type store of `rosbags`. Those of our own topics are read by their
definitions: `rosbags` reads any type, and takes longer to make its decoders than a bag to read. A
test compares both.
"""

from __future__ import annotations

import re
import struct
from functools import cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ema_record.errors import InvalidRecordError
from ema_record.limits import MAX_SMALL_MESSAGE_BYTES
from ema_record.wire.definitions import DEFINITIONS

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

NANOSECONDS = 1_000_000_000
SCHEMA_ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"
_NUMBERS = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h",
    "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f",
    "float64": "d",
}
"""Format of each type of number, as `struct` has it."""
_SEQUENCE = -1
_FIELD = re.compile(r"^([\w/]+)(\[(\d*)\])? (\w+)$", re.MULTILINE)


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


class _Field(NamedTuple):
    name: str
    kind: str
    """Type of number, ``string``, or a type of `DEFINITIONS`."""
    many: int | None
    """None: one; `_SEQUENCE`: as many as the message says."""


@cache
def _fields(message_type: str) -> tuple[_Field, ...]:
    found = []
    for kind, several, count, name in _FIELD.findall(DEFINITIONS[message_type]):
        package, _, short = kind.partition("/")
        found.append(_Field(name, f"{package}/msg/{short}" if short else kind,
                            int(count or _SEQUENCE) if several else None))
    return tuple(found)


def decode(data: bytes | memoryview, message_type: str) -> Any:
    """Return a message of a type of `DEFINITIONS`.

    Parameters
    ----------
    data : CDR with its encapsulation, of either endianness; more may follow.

    Returns
    -------
    Its fields are attributes; several numbers are an array, other elements a list.

    Raises
    ------
    ValueError, struct.error
        It is cut, or no plain CDR.
    """
    head, body = bytes(data[:4]), bytes(data[4:])
    if head[:2] not in (b"\x00\x00", b"\x00\x01") or len(head) < 4:
        raise ValueError(f"encapsulation {head.hex()!r} is not plain CDR")
    return _Reader(body, "<" if head[1] else ">").message(message_type)


class _Reader:
    """What is left of a message; every count is bounded by the bytes that are there."""

    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._order, self._at = body, order, 0

    def message(self, message_type: str) -> Any:
        found = SimpleNamespace()
        for name, kind, count in _fields(message_type):
            setattr(found, name, self._one(kind) if count is None else self._many(kind, count))
        return found

    def _one(self, kind: str) -> Any:
        if kind in _NUMBERS:
            return self._numbers(_NUMBERS[kind], 1)[0]
        return self._text() if kind == "string" else self.message(kind)

    def _many(self, kind: str, count: int) -> Any:
        if count == _SEQUENCE:
            count = self._numbers("I", 1)[0]
        if kind in _NUMBERS:
            return np.array(self._numbers(_NUMBERS[kind], count), dtype=_NUMBERS[kind])
        if count > len(self._body) - self._at:  # each takes a byte at least
            raise ValueError(f"{count} elements in {len(self._body) - self._at} bytes")
        return [self._one(kind) for _ in range(count)]

    def _numbers(self, code: str, count: int) -> tuple[Any, ...]:
        if not count:
            return ()
        size = struct.calcsize("=" + code)
        self._at += -self._at % size
        missing = self._at + size * count - len(self._body)
        if missing > 0:
            raise ValueError(f"{missing} bytes are missing")
        found = struct.unpack_from(f"{self._order}{count}{code}", self._body, self._at)
        self._at += size * count
        return found

    def _text(self) -> str:
        length = self._numbers("I", 1)[0]
        missing = self._at + length - len(self._body)
        if missing > 0:
            raise ValueError(f"{missing} bytes are missing")
        self._at += length
        return self._body[self._at - length:self._at - 1].decode() if length else ""
