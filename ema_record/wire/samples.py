"""Blocks of `/ema/samples` to and from CDR: std_msgs/Float64MultiArray, a whole block at once.

What stands in a message of m channels, at most 10 of the actuator's test (XCDR1, offsets count
from the end of the 4 bytes of encapsulation)::

    dim[0]  label "sample"            size n   stride n * m
    dim[1]  label "time[s],..."       size m   stride m
    data_offset 0
    data    n * m float64, row by row, aligned to 8
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache

import numpy as np

from ema_record.channels import ALL, CHANNEL_LABEL, N_CHANNELS, columns_of, label_of
from ema_record.errors import InvalidRecordError, UsageError
from ema_record.limits import MAX_MESSAGE_BYTES

SAMPLE_LABEL = "sample"
BLOCK_SIZE = 500
"""Samples a block, as the simulator publishes and `write_bag` writes them."""
MAX_BLOCK_SIZE = MAX_MESSAGE_BYTES // (8 * N_CHANNELS) - 16
"""Most samples of one block."""

_HEADER = 4
_LITTLE_ENDIAN = b"\x00\x01"
_BIG_ENDIAN = b"\x00\x00"
_MAX_LABEL = 4096


def _pad(buffer: bytearray, size: int) -> None:
    buffer.extend(bytes(-(len(buffer) - _HEADER) % size))


@cache
def _prefix(label: str) -> tuple[bytes, int, int, int]:
    """Return all before the data, where size and length stand in it, and how many columns."""
    out = bytearray(_LITTLE_ENDIAN + b"\x00\x00")
    out += struct.pack("<I", 2)
    places = []
    columns = label.count(",") + 1
    for name, stride in ((SAMPLE_LABEL, 0), (label, columns)):
        text = name.encode() + b"\x00"
        out += struct.pack("<I", len(text)) + text
        _pad(out, 4)
        places.append(len(out))
        out += struct.pack("<II", stride, stride)
    out += struct.pack("<I", 0)
    length = len(out)
    out += struct.pack("<I", 0)
    _pad(out, 8)
    return bytes(out), places[0], length, columns


def encode_block(block: np.ndarray, label: str = CHANNEL_LABEL) -> bytes:
    """Return one block as a serialised std_msgs/Float64MultiArray.

    Parameters
    ----------
    block : ndarray, shape (n, m), n >= 1.
    label : names and units of the m columns, with commas between.

    Returns
    -------
    bytes
        CDR with its encapsulation, little endian; ready for ``publisher.publish`` and for
        `RawBag.write_raw`.

    Raises
    ------
    UsageError
        Wrong shape, or more than `MAX_BLOCK_SIZE` samples.
    """
    head, at_size, at_length, columns = _prefix(label)
    if block.ndim != 2 or block.shape[1] != columns or not 1 <= len(block) <= MAX_BLOCK_SIZE:
        raise UsageError(
            f"block of samples has shape {block.shape}, expected (n, {columns}) with "
            f"1 <= n <= {MAX_BLOCK_SIZE}: publish smaller blocks"
        )
    prefix = bytearray(head)
    struct.pack_into("<II", prefix, at_size, len(block), block.size)
    struct.pack_into("<I", prefix, at_length, block.size)
    return bytes(prefix) + np.ascontiguousarray(block, dtype="<f8").tobytes()


def encode_samples(block: np.ndarray, columns: tuple[int, ...] = ALL) -> bytes:
    """Return samples, shape (n, 10), as `encode_block`; only `columns` are in the message."""
    if columns == ALL:
        return encode_block(block)
    return encode_block(block[:, list(columns)], label_of(columns))


class _Cursor:
    """Reads CDR numbers and labels; every length is checked against what is there."""

    def __init__(self, data: bytes | memoryview) -> None:
        self.data = data
        kind = bytes(data[:2])
        if len(data) < _HEADER or kind not in (_LITTLE_ENDIAN, _BIG_ENDIAN):
            raise InvalidRecordError(
                f"/ema/samples: encapsulation {bytes(data[:4]).hex()!r} is not plain CDR "
                "(0000 or 0001): the message is damaged or of another middleware"
            )
        self.order = "<" if kind == _LITTLE_ENDIAN else ">"
        self.at = _HEADER

    def align(self, size: int) -> None:
        self.at += -(self.at - _HEADER) % size

    def uint32(self) -> int:
        self.align(4)
        if self.at + 4 > len(self.data):
            raise _short(self.at + 4, len(self.data))
        (value,) = struct.unpack_from(self.order + "I", self.data, self.at)
        self.at += 4
        return int(value)

    def label(self) -> bytes:
        length = self.uint32()
        if length > _MAX_LABEL:
            raise InvalidRecordError(
                f"/ema/samples: a label of {length} bytes, at most {_MAX_LABEL}: damaged message"
            )
        if self.at + length > len(self.data):
            raise _short(self.at + length, len(self.data))
        text = bytes(self.data[self.at:self.at + length])
        self.at += length
        return text.rstrip(b"\x00")


def _short(needed: int, found: int) -> InvalidRecordError:
    return InvalidRecordError(
        f"/ema/samples: message of {found} bytes, needs {needed}: it is cut or damaged"
    )


def decode_block(data: bytes | memoryview) -> np.ndarray:
    """Return the samples of a message of `/ema/samples` of the actuator's test.

    Returns
    -------
    ndarray, shape (n, 10)
        Columns and units as in `channels.CHANNELS`, NaN where the message lacks the channel;
        otherwise as `decode_labelled`.

    Raises
    ------
    InvalidRecordError
        Damaged, too large, other channels, or one is missing that must be there.
    """
    label, samples = decode_labelled(data, columns_of)
    if label == CHANNEL_LABEL:
        return samples
    whole = np.full((len(samples), N_CHANNELS), np.nan)
    whole[:, list(columns_of(label))] = samples
    return whole


def decode_labelled(
    data: bytes | memoryview, check: Callable[[str], object] | None = None
) -> tuple[str, np.ndarray]:
    """Return the label of the channels and the samples of a std_msgs/Float64MultiArray.

    Parameters
    ----------
    data : CDR with its encapsulation, of either endianness.
    check : takes the label and raises unless it is right, before sizes are compared with it.

    Returns
    -------
    label : str
        Names and units, with commas between.
    samples : ndarray, shape (n, m)
        Float64; read-only and without a copy where `data` is little endian. The values are
        not checked.

    Raises
    ------
    InvalidRecordError
        Damaged, too large, or no block of [sample, channel].
    """
    if len(data) > MAX_MESSAGE_BYTES:
        raise InvalidRecordError(
            f"/ema/samples: message of {len(data)} bytes, at most {MAX_MESSAGE_BYTES}: "
            "publish smaller blocks"
        )
    cursor = _Cursor(data)
    dimensions = cursor.uint32()
    if dimensions != 2:
        raise InvalidRecordError(
            f"/ema/samples: {dimensions} dimensions, expected 2 (sample, channel): "
            "publish blocks of [sample, channel]"
        )
    sample_label = cursor.label()
    rows, row_stride = cursor.uint32(), cursor.uint32()
    channel_label = cursor.label()
    columns, column_stride = cursor.uint32(), cursor.uint32()
    offset, length = cursor.uint32(), cursor.uint32()
    if sample_label != SAMPLE_LABEL.encode():
        raise InvalidRecordError(
            f"/ema/samples: first dimension is {sample_label[:40]!r}, expected "
            f"{SAMPLE_LABEL!r}: publish blocks of [sample, channel]"
        )
    label = channel_label.decode("utf-8", errors="replace")
    if check is not None:
        check(label)
    named = label.count(",") + 1
    if (columns, column_stride, offset) != (named, named, 0) or not (
        length == row_stride == rows * named
    ):
        raise InvalidRecordError(
            f"/ema/samples: {length} numbers at offset {offset} for {rows} x {columns} "
            f"(strides {row_stride}, {column_stride}), expected n * {named} without gaps: "
            "the message is damaged"
        )
    if length == 0:
        return label, np.empty((0, named))
    cursor.align(8)
    end = cursor.at + 8 * length
    if end > len(data):
        raise _short(end, len(data))
    if len(data) - end > 3:
        raise InvalidRecordError(
            f"/ema/samples: {len(data) - end} bytes follow the last sample: damaged message"
        )
    values = np.frombuffer(data, dtype=cursor.order + "f8", count=length, offset=cursor.at)
    return label, values.astype(np.float64, copy=False).reshape(rows, named)
