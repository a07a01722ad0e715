"""Messages of our own topics are decoded as `rosbags` decodes them; cuts are errors."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ema_record.errors import InvalidRecordError
from ema_record.wire.definitions import DEFINITIONS, _fields, decode
from ema_record.wire.types import deserialize, message_class, typestore

WHOLE = {"int8": (-128, 127), "uint8": (0, 255), "byte": (0, 127), "int16": (-2**15, 2**15 - 1),
         "uint16": (0, 2**16 - 1), "int32": (-2**31, 2**31 - 1), "uint32": (0, 2**32 - 1),
         "int64": (-2**63, 2**63 - 1), "uint64": (0, 2**64 - 1)}
MESSAGES = ("sensor_msgs/msg/BatteryState", "sensor_msgs/msg/Temperature",
            "trajectory_msgs/msg/JointTrajectory", "sensor_msgs/msg/JointState",
            "diagnostic_msgs/msg/DiagnosticArray", "std_msgs/msg/Bool")


def value(draw, kind):
    if kind in WHOLE:
        return draw(st.integers(*WHOLE[kind]))
    if kind == "bool":
        return draw(st.booleans())
    if kind in ("float32", "float64"):
        return draw(st.floats(width=int(kind[5:]), allow_nan=False))
    return draw(st.text(max_size=9)) if kind == "string" else message(draw, kind)


def message(draw, message_type):
    fields = {}
    for name, kind, count in _fields(message_type):
        if count is None:
            fields[name] = value(draw, kind)
            continue
        several = [value(draw, kind) for _ in range(draw(st.integers(0, 3)))]
        number = kind in WHOLE or kind.startswith("float")
        fields[name] = np.array(several, dtype=kind) if number else several
    return message_class(message_type)(**fields)


def plain(found):
    """Return a message as values, of whatever classes it is made."""
    if isinstance(found, list | np.ndarray):
        return [plain(one) for one in found]
    fields = getattr(found, "__dict__", None) or {
        name: getattr(found, name) for name in getattr(found, "__dataclass_fields__", {})}
    return {name: plain(inner) for name, inner in fields.items() if not name.startswith("__")
            } if fields else found


@pytest.mark.slow
@settings(deadline=None, max_examples=30)
@given(st.data(), st.booleans())
def test_messages_are_those_of_rosbags(data, little):
    message_type = data.draw(st.sampled_from(MESSAGES))
    store = typestore()
    given_message = message(data.draw, message_type)
    raw = bytes(store.serialize_cdr(given_message, message_type, little_endian=little))
    expected = plain(store.deserialize_cdr(raw, message_type))
    expected = without_constants(expected)
    assert plain(decode(raw, message_type)) == expected
    assert plain(decode(raw + b"more", message_type)) == expected
    for cut in {*range(0, len(raw), 7), len(raw) - 1}:
        with pytest.raises(InvalidRecordError) as error:
            deserialize(raw[:cut], message_type, "/x")
        assert "\n" not in str(error.value)


def without_constants(found):
    """Leave out the constants of a type, which `rosbags` keeps among the fields."""
    if isinstance(found, dict):
        return {k: without_constants(v) for k, v in found.items() if not k.isupper()}
    return [without_constants(one) for one in found] if isinstance(found, list) else found


def test_every_definition_is_read():
    for name, text in DEFINITIONS.items():
        lines = [line for line in text.splitlines() if line and "=" not in line]
        assert len(_fields(name)) == len(lines), name


@pytest.mark.parametrize("count", [2**32 - 1, 10**6])
def test_a_count_takes_no_more_than_there_is(count):
    head = struct.pack("<4BiIII", 0, 1, 0, 0, 0, 0, 1, 0)
    for kind in ("trajectory_msgs/msg/JointTrajectory", "sensor_msgs/msg/JointState"):
        with pytest.raises(InvalidRecordError, match=r"elements|missing"):
            deserialize(head + struct.pack("<I", count) + bytes(64), kind, "/x")
