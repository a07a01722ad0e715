"""Bags of ROS 2 as columns: fields of any message, decoded by the definition in the bag.

A column is the path of a field (``motor.current``, ``data[2]``), of a joint where the message
lists joints (``effort`` of the joint that is chosen, ``wrist.effort`` of another), and after a
topic and a colon that of another topic (``/motor:current``). ``stamp`` is the time of the header,
or of the recorder where there is none.
"""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from ema_record.bag.any_topic import AnyTopic, is_bag, list_topics, messages_of
from ema_record.errors import InvalidRecordError, UsageError, unknown_name
from ema_record.limits import MAX_SMALL_MESSAGE_BYTES
from ema_record.wire.topics import SAMPLES, split_name
from ema_record.wire.types import (
    MESSAGE_ENCODING,
    NANOSECONDS,
    SCHEMA_ENCODING,
    definition,
    typestore,
)
from ema_rig.map import BagSource
from ema_rig.table import Cells, Table, said_by

STAMP, LOG_TIME = "stamp", "log_time"
JOINT_STATE = "sensor_msgs/msg/JointState"
DYNAMIC_JOINT_STATE = "control_msgs/msg/DynamicJointState"
JOINTS = (JOINT_STATE, DYNAMIC_JOINT_STATE)
FIELDS = ("position", "velocity", "effort")
MAX_LISTED = 32
"""Elements of an array that are listed one by one."""
_DYNAMIC = """std_msgs/Header header
string[] joint_names
InterfaceValue[] interface_values
================================================================================
MSG: control_msgs/InterfaceValue
string[] interface_names
float64[] values
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
"""Of control_msgs, which the type store lacks; sqlite3 bags before Iron hold no definitions."""
_INDEX = re.compile(r"^(\w+)((?:\[\d{1,6}\])*)$")
Field = Callable[[Any], float | None]


def read_ros_bag(path: Path, source: BagSource, needed: Sequence[str | int]) -> Table:
    """Return the columns of a bag that are needed.

    Parameters
    ----------
    path : a rosbag2 directory, an ``.mcap`` or a ``.db3`` file.
    source : the topic, and the joint of it.
    needed : columns as the module says.

    Returns
    -------
    Table
        Times count from the first message (s). Columns of other topics have their own.

    Raises
    ------
    InvalidRecordError, IncompleteRecordError, UsageError
        The bag is damaged or cut; no such topic, joint or field; a message cannot be decoded.
    """
    topics = list_topics(path)
    names = [str(name) for name in needed if name not in (STAMP, LOG_TIME)]
    wanted: dict[str, dict[str, str]] = {source.topic: {}}
    for name in names:
        topic, _, field = name.partition(":") if name.startswith("/") else (source.topic, "", name)
        wanted.setdefault(topic, {})[name] = field
    readers = {}
    for topic, fields in wanted.items():
        if topic not in topics:
            raise unknown_name("topic", topic, topics, f"{path}: the bag has {listed(topics)}")
        joint = source.joint if topic == source.topic else None
        readers[topic] = _TopicReader(topics[topic], fields, joint, str(path))
    first: int | None = None
    for topic, log_time, data in messages_of(path, frozenset(readers)):
        first = log_time if first is None else min(first, log_time)
        readers[topic].take(log_time, data)
    columns: dict[str, Cells] = {}
    times: dict[str, np.ndarray] = {}
    notes: list[str] = []
    stamped = all(reader.stamped for reader in readers.values())
    zero = min((t for r in readers.values() for t in r.clock(stamped=stamped)[:1]), default=0)
    for topic, reader in readers.items():
        found, told = reader.columns()
        columns |= found
        notes += told
        clock = (np.array(reader.clock(stamped=stamped), dtype=np.int64) - zero) / NANOSECONDS
        if topic == source.topic:
            columns[STAMP] = clock
            columns[LOG_TIME] = (np.array(reader.logged, dtype=np.int64)
                                 - (first or 0)) / NANOSECONDS
        else:
            times |= dict.fromkeys(found, clock)
    notes.append(f"time is that of the {'headers' if stamped else 'recorder'}")
    return Table(columns=columns, source=f"{path}: {source.topic}", notes=tuple(notes),
                 times=times)


def listed(topics: dict[str, AnyTopic]) -> str:
    """Return the topics of a bag with their types, in words."""
    shown = [f"{t.name} ({t.type}, {t.messages})" for t in topics.values()]
    return ", ".join(shown[:8]) + (f" and {len(shown) - 8} more" if len(shown) > 8 else "")


def is_of_an_actuator(topics: Iterable[str]) -> bool:
    """Whether a bag with these topics holds the samples of an actuator, in a namespace or not."""
    return any(split_name(name).topic == SAMPLES for name in topics)


def how_to_import(path: Path) -> UsageError | None:
    """Return what to do with a file or bag that is no bag of ours, None where it is one."""
    if not is_bag(path):
        name = shlex.quote(str(path))
        return UsageError(f"{path}: a file of another tool: 'ema import {name} --out axis' makes "
                          "a bag of it; then 'ema identify axis'") if path.is_file() else None
    topics = list_topics(path)
    if is_of_an_actuator(topics):
        return None
    joints = [topic.name for topic in topics.values() if topic.type in JOINTS]
    how = f"--topic {joints[0]} --joint NAME" if joints else "--topic TOPIC"
    return UsageError(f"{path}: a bag of other topics ({listed(topics)}): 'ema import {path} "
                      f"{how} --out axis' makes one of its axis; then 'ema identify axis'")


def decoder_of(topic: AnyTopic, source: str) -> Callable[[bytes], Any]:
    """Return what turns the bytes of a topic's messages into messages.

    Raises
    ------
    UsageError
        Messages in another encoding, or no definition of their type.
    """
    if topic.encoding != MESSAGE_ENCODING:
        raise UsageError(f"{source}: {topic.name} is in {topic.encoding[:20]!r}, expected "
                         f"{MESSAGE_ENCODING!r}: record it by ROS 2")
    text = topic.schema if topic.schema_encoding == SCHEMA_ENCODING else ""
    if not text.strip() and topic.type in typestore().fielddefs:
        text = definition(topic.type)
    if not text.strip() and topic.type == DYNAMIC_JOINT_STATE:
        text = _DYNAMIC
    if not text.strip():
        raise UsageError(
            f"{source}: {topic.name}: the bag holds no definition of {topic.type[:80]!r} in "
            f"{SCHEMA_ENCODING!r}: convert it where its package is installed, with 'ros2 bag "
            "convert' to storage mcap")
    schema = Schema(id=1, name=topic.type, encoding=SCHEMA_ENCODING, data=text.encode())
    try:
        with contextlib.redirect_stderr(io.StringIO()):  # its parser prints what it meets
            decode = DecoderFactory().decoder_for(MESSAGE_ENCODING, schema)
    except Exception as error:  # noqa: BLE001  (its parser raises whatever it meets)
        raise InvalidRecordError(f"{source}: {topic.name}: the definition of {topic.type[:80]!r} "
                                 f"is damaged ({said_by(error)}): record again") from None
    assert decode is not None  # both encodings are right
    return decode


class _TopicReader:
    """Fields of the messages of one topic."""

    def __init__(
        self, topic: AnyTopic, fields: dict[str, str], joint: str | None, source: str
    ) -> None:
        self.topic, self.source, self.joint = topic, source, joint
        self.logged: list[int] = []
        self.stamps: list[int] = []
        self.joints: set[str] = set()
        self._decode = decoder_of(topic, source)
        self._values: dict[str, list[float | None]] = {name: [] for name in fields}
        self._paths = fields
        self._fields: dict[str, Field] = {
            name: self._field(path) for name, path in fields.items()}
        self._seen = 0
        self._without = 0

    def take(self, log_time: int, data: bytes) -> None:
        """Decode one message and keep what is wanted of it."""
        self._seen += 1
        message = decoded(self._decode, data, self.topic, self._seen, self.source)
        self.joints.update(joints_of(message))
        found = {name: field(message) for name, field in self._fields.items()}
        if found and all(value is None for value in found.values()):
            self._without += 1  # another publisher of the topic, with other joints
            return
        for name, value in found.items():
            self._values[name].append(value)
        self.logged.append(log_time)
        self.stamps.append(_stamp(message))

    @property
    def stamped(self) -> bool:
        """Whether the headers hold times."""
        return bool(self.stamps) and min(self.stamps) > 0 and max(self.stamps) > min(self.stamps)

    def clock(self, *, stamped: bool) -> list[int]:
        """Return the times of the messages (ns)."""
        return self.stamps if stamped else self.logged

    def columns(self) -> tuple[dict[str, np.ndarray], list[str]]:
        """Return the columns, NaN where a message lacks the field, and what there is to say."""
        if not self._seen:
            raise InvalidRecordError(f"{self.source}: no message on {self.topic.name}: nothing "
                                     "was recorded of it")
        for name, path in self._paths.items():
            if not any(value is not None for value in self._values[name]):
                raise self._absent(name, path)
        told = [f"{self._without} of {self._seen} messages on {self.topic.name} are of other "
                "joints"] if self._without else []
        return {name: np.array([np.nan if value is None else value for value in values])
                for name, values in self._values.items()}, told

    def _absent(self, name: str, path: str) -> UsageError:
        place = f"{self.source}: {self.topic.name}"
        if self.topic.type in JOINTS:
            joint, _, field = path.rpartition(".")
            joint = joint or self.joint or ""
            if joint not in self.joints:
                return unknown_name("joint", joint, sorted(self.joints), f"{place} has "
                                    f"{', '.join(sorted(self.joints)[:12])}: give --joint")
            return UsageError(f"{place}: joint {joint!r} has no {field!r} in any message: publish "
                              "it, or name the column of another topic in the map")
        return UsageError(f"{place}: no field {path!r} with a number in any message: 'ema import "
                          f"BAG --topic {self.topic.name} --preview' lists them; column {name!r} "
                          "of the map")

    def _field(self, path: str) -> Field:
        if self.topic.type in JOINTS and not path.startswith("header."):
            joint, _, field = path.rpartition(".")
            joint = joint or self.joint or ""
            if not joint:
                raise UsageError(f"{self.source}: {self.topic.name} is of several joints: give "
                                 "--joint NAME, or 'joint:' under 'bag:' in the map")
            return of_joint(joint, field)
        steps: list[str | int] = []
        for part in path.split("."):
            matched = _INDEX.match(part)
            if matched is None:
                raise UsageError(f"{self.source}: {path[:80]!r} is no path of a field: write "
                                 "motor.current or data[2]")
            steps += [matched[1], *(int(n) for n in re.findall(r"\d+", matched[2]))]
        return lambda message: _follow(message, steps)


def decoded(
    decode: Callable[[bytes], Any], data: bytes, topic: AnyTopic, number: int, source: str
) -> Any:
    """Return the message that bytes hold; InvalidRecordError where they hold none."""
    try:
        if len(data) > MAX_SMALL_MESSAGE_BYTES:
            raise ValueError(f"at most {MAX_SMALL_MESSAGE_BYTES} are read")
        return decode(data)
    except Exception as error:  # noqa: BLE001  (decoders raise what struct and memory raise)
        raise InvalidRecordError(
            f"{source}: message {number} on {topic.name}: {len(data)} bytes are no {topic.type} "
            f"({said_by(error) or type(error).__name__}): the bag is damaged, or of another "
            "version of that type") from None


def joints_of(message: Any) -> Sequence[str]:
    """Return the joints that a message lists."""
    names = getattr(message, "name", None) or getattr(message, "joint_names", None)
    return [str(name) for name in names] if isinstance(names, list) else []


def of_joint(joint: str, field: str) -> Field:
    """Return what takes a field of one joint out of a message, None where it is not there."""
    def find(message: Any) -> float | None:
        names = joints_of(message)
        if joint not in names:
            return None
        place = names.index(joint)
        if hasattr(message, "interface_values"):
            if place >= len(message.interface_values):
                return None
            inner = message.interface_values[place]
            kinds = list(inner.interface_names)
            return _number(inner.values, kinds.index(field)) if field in kinds else None
        return _number(getattr(message, field, ()), place)
    return find


def numbers_in(message: Any, path: str = "") -> dict[str, float]:
    """Return all numbers of a message by the paths of their fields."""
    found: dict[str, float] = {}
    if isinstance(message, bool | int | float):
        return {path: float(message)}
    if isinstance(message, str | bytes):
        return {}
    if hasattr(message, "__len__"):
        for k in range(min(len(message), MAX_LISTED)):
            found |= numbers_in(message[k], f"{path}[{k}]")
        return found
    for name in getattr(message, "__slots__", ()):
        if name != "header":
            found |= numbers_in(getattr(message, name), f"{path}.{name}".lstrip("."))
    return found


def _number(values: Any, place: int) -> float | None:
    return float(values[place]) if hasattr(values, "__len__") and place < len(values) else None


def _follow(message: Any, steps: Sequence[str | int]) -> float | None:
    for step in steps:
        if isinstance(step, str):
            message = getattr(message, step, None)
        else:
            message = message[step] if hasattr(message, "__len__") and step < len(
                message) else None
        if message is None:
            return None
    return float(message) if isinstance(message, bool | int | float) else None


def _stamp(message: Any) -> int:
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)
