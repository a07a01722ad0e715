"""Blocks of samples: round trips, what rclpy and rosbags make of them, damaged messages."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rosbags.typesys import Stores, get_typestore

from ema_record.actuator import load_actuator
from ema_record.channels import (
    ALL,
    CHANNEL_LABEL,
    N_CHANNELS,
    columns_of,
    label_of,
    recorded_columns,
)
from ema_record.errors import InvalidRecordError, UsageError
from ema_record.wire.samples import MAX_BLOCK_SIZE, decode_block, encode_block, encode_samples

TYPE = "std_msgs/msg/Float64MultiArray"
STORE = get_typestore(Stores.ROS2_JAZZY)


def foreign_message(block, label=CHANNEL_LABEL, sample_label="sample"):
    """The same block as a message object of rosbags."""
    types = STORE.types
    dimension = types["std_msgs/msg/MultiArrayDimension"]
    layout = types["std_msgs/msg/MultiArrayLayout"](
        dim=[
            dimension(label=sample_label, size=len(block), stride=block.size),
            dimension(label=label, size=block.shape[1], stride=block.shape[1]),
        ],
        data_offset=0,
    )
    return types[TYPE](layout=layout, data=np.ascontiguousarray(block, dtype=float).ravel())


BLOCKS = st.integers(1, 40).flatmap(
    lambda n: arrays(np.float64, (n, N_CHANNELS), elements=st.floats(width=64))
)


@settings(max_examples=100, deadline=None)
@given(BLOCKS)
def test_round_trip_is_exact(block):
    assert decode_block(encode_block(block)).tobytes() == block.tobytes()


@settings(max_examples=50, deadline=None)
@given(BLOCKS)
def test_bytes_equal_those_of_rosbags(block):
    assert encode_block(block) == bytes(STORE.serialize_cdr(foreign_message(block), TYPE))


@pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # an old lark of rclpy's
@pytest.mark.parametrize("rows", [1, 3, 200, 500])
def test_equals_rclpy(rows):
    """The same message as rclpy's, its padding excepted (Fast CDR leaves it uninitialised)."""
    import array

    from rclpy.serialization import deserialize_message, serialize_message
    from std_msgs.msg import Float64MultiArray, MultiArrayDimension

    block = np.random.default_rng(rows).normal(size=(rows, N_CHANNELS))
    message = Float64MultiArray()
    message.layout.dim = [
        MultiArrayDimension(label="sample", size=rows, stride=block.size),
        MultiArrayDimension(label=CHANNEL_LABEL, size=N_CHANNELS, stride=N_CHANNELS),
    ]
    message.data = array.array("d", block.tobytes())
    theirs, ours = serialize_message(message), encode_block(block)
    assert len(theirs) == len(ours)
    text = ours[: len(ours) - block.nbytes]
    padding = set()
    at = 8  # encapsulation, number of dimensions
    for _ in range(2):
        (length,) = struct.unpack_from("<I", text, at)
        at += 4 + length
        padding |= set(range(at, at + -(at - 4) % 4))
        at += -(at - 4) % 4 + 8
    padding |= set(range(at + 8, len(text)))
    assert len(padding) <= 10
    assert all(ours[k] == theirs[k] for k in range(len(ours)) if k not in padding)
    assert deserialize_message(ours, Float64MultiArray) == message
    np.testing.assert_array_equal(decode_block(theirs), block)


def test_big_endian_is_read():
    block = np.random.default_rng(1).normal(size=(7, N_CHANNELS))
    data = bytes(STORE.serialize_cdr(foreign_message(block), TYPE, little_endian=False))
    assert data[:2] == b"\x00\x00"
    np.testing.assert_array_equal(decode_block(data), block)


def test_any_memory_layout_is_encoded():
    block = np.asfortranarray(np.arange(200.0).reshape(20, N_CHANNELS))
    np.testing.assert_array_equal(decode_block(encode_block(block[::2])), block[::2])


@pytest.mark.parametrize("shape", [(0, N_CHANNELS), (5, 9), (N_CHANNELS,),
                                   (MAX_BLOCK_SIZE + 1, N_CHANNELS)])
def test_wrong_shape_is_refused(shape):
    with pytest.raises(UsageError, match="shape"):
        encode_block(np.broadcast_to(0.0, shape))


def test_every_cut_is_refused():
    data = encode_block(np.ones((2, N_CHANNELS)))
    for length in range(len(data)):
        with pytest.raises(InvalidRecordError):
            decode_block(data[:length])


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 239), st.binary(min_size=1, max_size=8))
def test_damage_is_an_error_or_the_same_shape(at, damage):
    """Any overwritten bytes: a clear error, or a block of the size that the message holds."""
    data = bytearray(encode_block(np.ones((3, N_CHANNELS))))
    data[at:at + len(damage)] = damage[: len(data) - at]
    try:
        block = decode_block(bytes(data))
    except InvalidRecordError as error:
        assert "\n" not in str(error)
    else:
        assert block.shape == (3, N_CHANNELS)


@pytest.mark.parametrize("label", [CHANNEL_LABEL + "\t", CHANNEL_LABEL.replace(",", ", "),
                                   CHANNEL_LABEL + ",", CHANNEL_LABEL[:-1], ""])
def test_a_label_that_differs_by_a_character_is_refused(label):
    with pytest.raises(InvalidRecordError, match="/ema/samples"):
        columns_of(label)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400))
def test_noise_is_refused(noise):
    with pytest.raises(InvalidRecordError):
        decode_block(b"\x00\x01\x00\x00" + noise)


@pytest.mark.parametrize("kind", [b"\x00\x03", b"\x00\x07", b"\x01\x00"])
def test_other_encapsulation_is_refused(kind):
    with pytest.raises(InvalidRecordError, match="plain CDR"):
        decode_block(kind + encode_block(np.ones((1, N_CHANNELS)))[2:])


@pytest.mark.parametrize(
    ("label", "sample_label", "match"),
    [
        (CHANNEL_LABEL.replace("motor_speed[rad/s]", "motor_speed[rpm]"), "sample",
         r"channel 1 is 'motor_speed.rpm.', expected in .rad/s."),
        (CHANNEL_LABEL.replace("motor_speed[rad/s],", ""), "sample", "no channel motor_speed"),
        (CHANNEL_LABEL + ",extra[V]", "sample", "channel 10 is 'extra.V.', none of the channel"),
        (CHANNEL_LABEL, "channel", "first dimension"),
    ],
)
def test_wrong_channels_are_named(label, sample_label, match):
    message = foreign_message(np.ones((2, label.count(",") + 1)), label, sample_label)
    with pytest.raises(InvalidRecordError, match=match):
        decode_block(bytes(STORE.serialize_cdr(message, TYPE)))


SUBSETS = st.sets(st.sampled_from(ALL[4:])).flatmap(
    lambda rest: st.sampled_from([(2, 3), (2, 4), (3, 4), (2, 3, 4)]).map(
        lambda currents: tuple(sorted({0, 1, *currents, *rest})))
)


@settings(max_examples=50, deadline=None)
@given(SUBSETS, BLOCKS)
def test_channels_that_a_recorder_lacks_are_nan(columns, block):
    """Written are the others alone, under their names; read back, exactly they are there."""
    block = np.where(np.isfinite(block), block, 1.0)
    data = encode_samples(block, columns)
    assert len(data) < 600 + 8 * len(columns) * len(block)
    found = decode_block(data)
    missing = [c for c in ALL if c not in columns]
    assert found[:, list(columns)].tobytes() == block[:, list(columns)].tobytes()
    assert np.isnan(found[:, missing]).all() and found.shape == block.shape
    assert columns_of(label_of(columns)) == columns == recorded_columns(found)


@pytest.mark.parametrize(("columns", "missing"), [
    ((1, 2, 3), "time"), ((0, 2, 3, 4), "motor_speed"), ((0, 1, 3), "phase_current_a"),
    ((0, 1, 2, *ALL[5:]), "phase_current_b"),
])
def test_what_must_be_there(columns, missing):
    with pytest.raises(InvalidRecordError, match=f"no channel {missing}"):
        columns_of(label_of(columns))


@pytest.mark.parametrize("columns", [(0, 1, 2, 3, 3), (1, 0, 2, 3), (0, 1, 3, 2)])
def test_channels_keep_their_order(columns):
    with pytest.raises(InvalidRecordError, match="keep the order"):
        columns_of(label_of(columns))


def test_a_column_of_nan_that_must_be_there_counts_as_recorded():
    """So that the check of the values finds it."""
    samples = np.ones((3, N_CHANNELS))
    samples[:, [1, 2, 3, 8]] = np.nan
    assert recorded_columns(samples) == tuple(c for c in ALL if c != 8)
    samples[0, 8] = 1.0  # a part of it alone is a fault, no absence
    assert recorded_columns(samples) == ALL


def test_the_channels_that_a_kit_says():
    acquisition = load_actuator().acquisition
    assert acquisition.columns == ALL
    least = acquisition._replace(
        phase_current_c=0, reference_currents=0, rotor_angle=0, surface_position=0)
    assert least.columns == (0, 1, 2, 3)
    assert acquisition._replace(rotor_angle=0).columns == (*ALL[:8], 9)


def test_too_large_a_message_is_refused():
    with pytest.raises(InvalidRecordError, match="at most"):
        decode_block(memoryview(np.zeros((16 << 20) + 1, dtype=np.uint8)))
