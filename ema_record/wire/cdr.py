"""CDR messages of our own topics, decoded by their definitions.

`rosbags` decodes any type, and takes longer to make its decoders than a bag to read. A test
compares both.
"""

from __future__ import annotations

import re
import struct
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ema_record.wire.definitions import DEFINITIONS

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
