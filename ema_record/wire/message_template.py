"""Many messages of one type that differ in numbers only, encoded together.

The message is serialised once with marks in the places of the numbers; the marks are
found again in the bytes, and the numbers of all messages are written there by columns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ema_record.wire.types import NANOSECONDS, serialize

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
    message_type : str
        E.g. ``sensor_msgs/msg/Temperature``.
    fields : mapping of str to str
        Names and numpy formats (``<f8``, ``<f4``, ``<i4``, ``<u4``) of the numbers.
    build : callable
        Takes a dict of the numbers, returns the message.

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
        stamps : ndarray of int64, shape (n,)
            Stamps of the headers (ns since the epoch).
        columns : mapping of str to ndarray, shape (n,)
            The numbers of each field other than ``sec`` and ``nanosec``.

        """
        size = len(self._bytes)
        buffer = bytearray(self._bytes * len(stamps))
        rows = np.frombuffer(buffer, dtype=self._dtype)  # a copy would lose what is no field
        rows["sec"], rows["nanosec"] = np.divmod(stamps, NANOSECONDS)
        for name, values in columns.items():
            rows[name] = values
        data = bytes(buffer)
        return [data[k * size:(k + 1) * size] for k in range(len(stamps))]
