"""Message types of our own topics: definitions as in ROS 2 Jazzy, and a reader that goes by them.

The whole type store of ROS 2 takes longer to build than a bag to read, and so do the decoders of
`rosbags`. A test compares both.
"""

from __future__ import annotations

import re
import struct
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

DEFINITIONS: dict[str, str] = {
    "builtin_interfaces/msg/Duration": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "diagnostic_msgs/msg/DiagnosticArray":
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status",
    "diagnostic_msgs/msg/DiagnosticStatus": """\
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values""",
    "diagnostic_msgs/msg/KeyValue": "string key\nstring value",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Vector3Stamped":
        "std_msgs/Header header\ngeometry_msgs/Vector3 vector",
    "sensor_msgs/msg/BatteryState": """\
uint8 POWER_SUPPLY_STATUS_UNKNOWN=0
uint8 POWER_SUPPLY_STATUS_CHARGING=1
uint8 POWER_SUPPLY_STATUS_DISCHARGING=2
uint8 POWER_SUPPLY_STATUS_NOT_CHARGING=3
uint8 POWER_SUPPLY_STATUS_FULL=4
uint8 POWER_SUPPLY_HEALTH_UNKNOWN=0
uint8 POWER_SUPPLY_HEALTH_GOOD=1
uint8 POWER_SUPPLY_HEALTH_OVERHEAT=2
uint8 POWER_SUPPLY_HEALTH_DEAD=3
uint8 POWER_SUPPLY_HEALTH_OVERVOLTAGE=4
uint8 POWER_SUPPLY_HEALTH_UNSPEC_FAILURE=5
uint8 POWER_SUPPLY_HEALTH_COLD=6
uint8 POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE=7
uint8 POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE=8
uint8 POWER_SUPPLY_TECHNOLOGY_UNKNOWN=0
uint8 POWER_SUPPLY_TECHNOLOGY_NIMH=1
uint8 POWER_SUPPLY_TECHNOLOGY_LION=2
uint8 POWER_SUPPLY_TECHNOLOGY_LIPO=3
uint8 POWER_SUPPLY_TECHNOLOGY_LIFE=4
uint8 POWER_SUPPLY_TECHNOLOGY_NICD=5
uint8 POWER_SUPPLY_TECHNOLOGY_LIMN=6
uint8 POWER_SUPPLY_TECHNOLOGY_TERNARY=7
uint8 POWER_SUPPLY_TECHNOLOGY_VRLA=8
std_msgs/Header header
float32 voltage
float32 temperature
float32 current
float32 charge
float32 capacity
float32 design_capacity
float32 percentage
uint8 power_supply_status
uint8 power_supply_health
uint8 power_supply_technology
bool present
float32[] cell_voltage
float32[] cell_temperature
string location
string serial_number""",
    "sensor_msgs/msg/JointState": """\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort""",
    "sensor_msgs/msg/Temperature":
        "std_msgs/Header header\nfloat64 temperature\nfloat64 variance",
    "std_msgs/msg/Bool": "bool data",
    "std_msgs/msg/Float64": "float64 data",
    "std_msgs/msg/Float64MultiArray": "std_msgs/MultiArrayLayout layout\nfloat64[] data",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/msg/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "std_msgs/msg/MultiArrayLayout":
        "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
    "std_msgs/msg/String": "string data",
    "trajectory_msgs/msg/JointTrajectory": """\
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint[] points""",
    "trajectory_msgs/msg/JointTrajectoryPoint": """\
float64[] positions
float64[] velocities
float64[] accelerations
float64[] effort
builtin_interfaces/Duration time_from_start""",
}
"""By type, without the comments."""
_NUMBERS = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h",
    "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f",
    "float64": "d",
}
"""Format of each type of number, as `struct` has it."""
_SEQUENCE = -1
_FIELD = re.compile(r"^([\w/]+)(\[(\d*)\])? (\w+)$", re.MULTILINE)


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

    Its fields are attributes; several numbers are an array, other elements a list.

    Parameters
    ----------
    data : CDR with its encapsulation, of either endianness; more may follow.

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
