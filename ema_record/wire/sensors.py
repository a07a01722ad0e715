"""The sensor topics of a record as standard messages: joints, currents, bus, temperature."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from ema_record.wire.topics import JOINT_MOTOR, JOINT_SURFACE
from ema_record.wire.types import NANOSECONDS, header, message_class, serialize

BOOL = "std_msgs/msg/Bool"
JOINT_STATE = "sensor_msgs/msg/JointState"
VECTOR3_STAMPED = "geometry_msgs/msg/Vector3Stamped"
BATTERY_STATE = "sensor_msgs/msg/BatteryState"
TEMPERATURE = "sensor_msgs/msg/Temperature"

_NOT_MEASURED = float("nan")
_LOCATION = "dc_bus"
_UNKNOWN, _DISCHARGING = 0, 2
"""Status of a supply, numbers of sensor_msgs/BatteryState."""

STAMP_FIELDS = {"sec": "<i4", "nanosec": "<u4"}


def _mark(index: int, kind: str) -> Any:
    """Return a number whose bytes occur nowhere else in the message."""
    if kind == "<f8":
        return float(np.frombuffer(bytes([index + 1, *b"\xa5\x5a\xc3\x3c\x96\x69"]) + b"\x40",
                                   "<f8")[0])
    if kind == "<f4":
        return float(np.frombuffer(bytes([index + 1]) + b"\xa5\x5a\x40", "<f4")[0])
    return int.from_bytes(bytes([index + 1]) + b"\xa5\x5a\x3c", "little")


class MessageTemplate:
    """Encoder of messages of one type that differ in some numbers only.

    Parameters
    ----------
    message_type : e.g. ``sensor_msgs/msg/Temperature``.
    fields : names and numpy formats (``<f8``, ``<f4``, ``<i4``, ``<u4``) of the numbers.
    build : takes a dict of the numbers, returns the message.
    """

    def __init__(
        self,
        message_type: str,
        fields: Mapping[str, str],
        build: Callable[[dict[str, Any]], Any],
    ) -> None:
        """Serialise one message and find the places of its numbers."""
        marks = {name: _mark(k, kind) for k, (name, kind) in enumerate(fields.items())}
        self._bytes = serialize(build(marks), message_type)
        offsets = []
        for name, kind in fields.items():
            pattern = np.array(marks[name], dtype=kind).tobytes()
            if self._bytes.count(pattern) != 1:
                raise AssertionError(f"{message_type}: no single place for {name}")
            offsets.append(self._bytes.index(pattern))
        self._dtype = np.dtype({
            "names": list(fields), "formats": list(fields.values()),
            "offsets": offsets, "itemsize": len(self._bytes),
        })

    def encode(self, stamps: np.ndarray, columns: Mapping[str, np.ndarray]) -> list[bytes]:
        """Return n messages, CDR with encapsulation.

        Parameters
        ----------
        stamps : ndarray of int64, shape (n,). Stamps of the headers (ns since the epoch).
        columns : mapping of str to ndarray, shape (n,). The numbers of each field other than
            ``sec`` and ``nanosec``.
        """
        size = len(self._bytes)
        buffer = bytearray(self._bytes * len(stamps))
        rows = np.frombuffer(buffer, dtype=self._dtype)  # a copy would lose what is no field
        rows["sec"], rows["nanosec"] = np.divmod(stamps, NANOSECONDS)
        for name, values in columns.items():
            rows[name] = values
        data = bytes(buffer)
        return [data[k * size:(k + 1) * size] for k in range(len(stamps))]


def _stamped(numbers: dict[str, Any]) -> Any:
    """Return a header whose two numbers stand as they are (a mark is no valid nanosecond)."""
    result = header(0)
    result.stamp.sec, result.stamp.nanosec = numbers["sec"], numbers["nanosec"]
    return result


@cache
def _joint_state() -> MessageTemplate:
    names = ("motor_position", "surface_position", "motor_velocity", "surface_velocity")
    return MessageTemplate(
        JOINT_STATE,
        STAMP_FIELDS | dict.fromkeys(names, "<f8"),
        lambda v: message_class(JOINT_STATE)(
            header=_stamped(v),
            name=[JOINT_MOTOR, JOINT_SURFACE],
            position=np.array([v["motor_position"], v["surface_position"]]),
            velocity=np.array([v["motor_velocity"], v["surface_velocity"]]),
            effort=np.empty(0),
        ),
    )


@cache
def _vector3() -> MessageTemplate:
    return MessageTemplate(
        VECTOR3_STAMPED,
        STAMP_FIELDS | dict.fromkeys("xyz", "<f8"),
        lambda v: message_class(VECTOR3_STAMPED)(
            header=_stamped(v),
            vector=message_class("geometry_msgs/msg/Vector3")(x=v["x"], y=v["y"], z=v["z"]),
        ),
    )


@cache
def _battery_state() -> MessageTemplate:
    none = np.empty(0, dtype=np.float32)
    return MessageTemplate(
        BATTERY_STATE,
        STAMP_FIELDS | {"voltage": "<f4", "current": "<f4"},
        lambda v: message_class(BATTERY_STATE)(
            header=_stamped(v), voltage=v["voltage"], current=v["current"],
            temperature=_NOT_MEASURED, charge=_NOT_MEASURED, capacity=_NOT_MEASURED,
            design_capacity=_NOT_MEASURED, percentage=_NOT_MEASURED,
            power_supply_status=_DISCHARGING, power_supply_health=0, power_supply_technology=0,
            present=True, cell_voltage=none, cell_temperature=none,
            location=_LOCATION, serial_number="",
        ),
    )


@cache
def _temperature() -> MessageTemplate:
    return MessageTemplate(
        TEMPERATURE,
        STAMP_FIELDS | {"temperature": "<f8"},
        lambda v: message_class(TEMPERATURE)(
            header=_stamped(v), temperature=v["temperature"], variance=0.0,
        ),
    )


def encode_joint_states(
    stamps: np.ndarray, position: np.ndarray, velocity: np.ndarray
) -> list[bytes]:
    """Return sensor_msgs/JointState messages of `motor` and `surface`.

    Parameters
    ----------
    stamps : ndarray of int64, shape (n,) (ns since the epoch).
    position : ndarray, shape (n, 2). Motor, surface (rad).
    velocity : ndarray, shape (n, 2). Motor, surface (rad/s).
    """
    return _joint_state().encode(stamps, {
        "motor_position": position[:, 0], "surface_position": position[:, 1],
        "motor_velocity": velocity[:, 0], "surface_velocity": velocity[:, 1],
    })


def encode_currents(stamps: np.ndarray, current: np.ndarray) -> list[bytes]:
    """Return geometry_msgs/Vector3Stamped messages; `current`: shape (n, 3) (A)."""
    return _vector3().encode(stamps, dict(zip("xyz", current.T)))


def encode_dc_bus(stamps: np.ndarray, voltage: np.ndarray, current: np.ndarray) -> list[bytes]:
    """Return sensor_msgs/BatteryState messages (float32) of a bus that feeds the drive.

    Parameters
    ----------
    stamps : ndarray of int64, shape (n,) (ns since the epoch).
    voltage : ndarray, shape (n,). Between the rails (V).
    current : ndarray, shape (n,). Positive into the drive (A); the message counts it negative: the
        supply is discharged.
    """
    drawn = np.subtract(0.0, current)  # without a negative zero
    return _battery_state().encode(stamps, {"voltage": voltage, "current": drawn})


def bus_reading(message: Any) -> tuple[float, float]:
    """Return voltage (V) and current (A, positive into the drive) of a sensor_msgs/BatteryState.

    The first bags of this software, known by a status that is unknown, hold it positive.
    """
    old = message.location == _LOCATION and message.power_supply_status == _UNKNOWN
    return float(message.voltage), float(message.current if old else 0.0 - message.current)


def encode_temperature(stamps: np.ndarray, temperature: np.ndarray) -> list[bytes]:
    """Return sensor_msgs/Temperature messages (degC)."""
    return _temperature().encode(stamps, {"temperature": temperature})


def encode_bool(value: bool) -> bytes:
    """Return a std_msgs/Bool message."""
    return serialize(message_class(BOOL)(data=value), BOOL)
