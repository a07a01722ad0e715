"""Blocks of `/ema/samples` to and from CDR: std_msgs/Float64MultiArray, a whole block at once.

What stands in a message (XCDR1, offsets count from the end of the 4 bytes of encapsulation)::

    dim[0]  label "sample"            size n   stride n * 10
    dim[1]  label "time[s],..."       size 10  stride 10
    data_offset 0
    data    n * 10 float64, row by row, aligned to 8
"""

from __future__ import annotations

import struct

import numpy as np

from ema_record.channels import CHANNEL_LABEL, N_CHANNELS, check_channel_label
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


def _build_prefix() -> tuple[bytes, int, int, int]:
    """Return everything before the data, and where the three numbers stand that vary."""
    out = bytearray(_LITTLE_ENDIAN + b"\x00\x00")
    out += struct.pack("<I", 2)
    places = []
    for label, stride in ((SAMPLE_LABEL, 0), (CHANNEL_LABEL, N_CHANNELS)):
        text = label.encode() + b"\x00"
        out += struct.pack("<I", len(text)) + text
        _pad(out, 4)
        places.append(len(out))
        out += struct.pack("<II", stride, stride)
    out += struct.pack("<I", 0)
    length = len(out)
    out += struct.pack("<I", 0)
    _pad(out, 8)
    return bytes(out), places[0], places[0] + 4, length


_PREFIX, _AT_SIZE, _AT_STRIDE, _AT_LENGTH = _build_prefix()
_CHANNEL_LABEL_BYTES = CHANNEL_LABEL.encode()


def encode_block(block: np.ndarray) -> bytes:
    """Return one block as a serialised std_msgs/Float64MultiArray.

    Parameters
    ----------
    block : ndarray, shape (n, 10)
        Columns and units as in `channels.CHANNELS`, n >= 1.

    Returns
    -------
    bytes
        CDR with its encapsulation, little endian; ready for ``publisher.publish`` and for
        `BagWriter.write_raw`.

    Raises
    ------
    UsageError
        Wrong shape, or more than `MAX_BLOCK_SIZE` samples.

    """
    if block.ndim != 2 or block.shape[1] != N_CHANNELS or not 1 <= len(block) <= MAX_BLOCK_SIZE:
        raise UsageError(
            f"block of samples has shape {block.shape}, expected (n, {N_CHANNELS}) with "
            f"1 <= n <= {MAX_BLOCK_SIZE}: publish smaller blocks"
        )
    prefix = bytearray(_PREFIX)
    struct.pack_into("<II", prefix, _AT_SIZE, len(block), len(block) * N_CHANNELS)
    struct.pack_into("<I", prefix, _AT_LENGTH, len(block) * N_CHANNELS)
    return bytes(prefix) + np.ascontiguousarray(block, dtype="<f8").tobytes()


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
    """Return the samples of a serialised std_msgs/Float64MultiArray of `/ema/samples`.

    Parameters
    ----------
    data : bytes-like
        CDR with its encapsulation, of either endianness.

    Returns
    -------
    ndarray, shape (n, 10)
        Float64; read-only and without a copy where `data` is little endian. The values are
        not checked.

    Raises
    ------
    InvalidRecordError
        Damaged, too large, or not the channels of `ema_record.channels`.

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
    if channel_label != _CHANNEL_LABEL_BYTES:
        check_channel_label(channel_label.decode("utf-8", errors="replace"))
    if (columns, column_stride, offset) != (N_CHANNELS, N_CHANNELS, 0) or not (
        length == row_stride == rows * N_CHANNELS
    ):
        raise InvalidRecordError(
            f"/ema/samples: {length} numbers at offset {offset} for {rows} x {columns} "
            f"(strides {row_stride}, {column_stride}), expected n * {N_CHANNELS} without gaps: "
            "the message is damaged"
        )
    if length == 0:
        return np.empty((0, N_CHANNELS))
    cursor.align(8)
    end = cursor.at + 8 * length
    if end > len(data):
        raise _short(end, len(data))
    if len(data) - end > 3:
        raise InvalidRecordError(
            f"/ema/samples: {len(data) - end} bytes follow the last sample: damaged message"
        )
    values = np.frombuffer(data, dtype=cursor.order + "f8", count=length, offset=cursor.at)
    return values.astype(np.float64, copy=False).reshape(rows, N_CHANNELS)
