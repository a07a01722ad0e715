"""MCAP files read as a stream: every record checked against a bound and against the file's end.

The libraries' readers start from the summary at the end of the file, which a cut file lacks
and a damaged one has wrong, and take lengths on trust. This one needs neither: it walks the
data section from its beginning, and says whether the file is whole, cut or damaged. Of a file
that is not whole it can also read what is left: a damaged chunk is left out, of one that the end
of the file cuts the messages before the cut are kept.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass, field
from typing import IO, NamedTuple

from mcap.opcode import Opcode

from ema_record.bag.compression import unpack, unpack_zstd_part
from ema_record.errors import IncompleteRecordError, InvalidRecordError, RecordError
from ema_record.limits import (
    MAX_CHANNELS,
    MAX_CHUNK_BYTES,
    MAX_MESSAGE_BYTES,
    MAX_MESSAGES,
    MAX_RECORD_BYTES,
    MAX_TOTAL_BYTES,
)

MAGIC = b"\x89MCAP0\r\n"

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQII")
_PIECE = 1 << 20

MOST_RECORDS = 10 * MAX_MESSAGES
"""In the chunks of a file, of all topics: an empty one takes next to no room, but time."""
_BOUNDS = {
    Opcode.HEADER: MAX_RECORD_BYTES,
    Opcode.SCHEMA: MAX_RECORD_BYTES,
    Opcode.CHANNEL: MAX_RECORD_BYTES,
    Opcode.METADATA: MAX_RECORD_BYTES,
    Opcode.DATA_END: 4,
    Opcode.MESSAGE: MAX_MESSAGE_BYTES + _MESSAGE.size,
    Opcode.CHUNK: MAX_CHUNK_BYTES + 256,
}


class McapChannel(NamedTuple):
    """A channel and its schema."""

    topic: str
    message_encoding: str
    schema_name: str
    metadata: dict[str, str]
    schema_encoding: str = ""
    """``ros2msg``, ``ros2idl``, ..."""
    schema: bytes = b""
    """The definition of the type."""


class McapMessage(NamedTuple):
    """One message as stored."""

    channel: McapChannel
    log_time: int
    publish_time: int
    data: memoryview


class McapMetadata(NamedTuple):
    """One metadata record."""

    name: str
    values: dict[str, str]


@dataclass
class McapStream:
    """One MCAP file, read from its beginning.

    Attributes
    ----------
    file : at its beginning.
    size : bytes in `file`.
    name : named in errors.
    topics : only these topics' messages are returned; None: all.
    validate_crcs : whether checksums are compared.
    on_damage : takes what cannot be read, as one line, and how many bytes it is; reading goes on
        where it can, and ends without an error. Without it damage is raised.
    """

    file: IO[bytes]
    size: int
    name: str
    topics: Container[str] | None = None
    validate_crcs: bool = True
    on_damage: Callable[[str, int], None] | None = None
    _at: int = 0
    _crc: int = 0
    _total: int = 0
    _records: int = 0
    _data_end: bool = False
    _schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    _channels: dict[int, McapChannel] = field(default_factory=dict)

    def __iter__(self) -> Iterator[McapMessage | McapMetadata]:
        """Return messages and metadata in the order of the file.

        Raises
        ------
        IncompleteRecordError
            The file ends before its data do.
        InvalidRecordError
            It is no MCAP file, or is damaged.

        With `on_damage` only what is no MCAP file, or is cut before its first record, raises.
        """
        if self.size == 0:
            raise InvalidRecordError(f"{self.name}: empty file (0 bytes): nothing was recorded")
        if self._read(min(len(MAGIC), self.size)) != MAGIC[: self.size]:
            raise InvalidRecordError(
                f"{self.name}: not an MCAP file (it begins otherwise): give a rosbag2 directory "
                "or an .mcap file"
            )
        try:
            while not self._data_end:
                yield from self._next()
            if not self._ends_with_magic():  # as a finished file does; the summary is not read
                raise self._cut()
            if self._goes_on():
                raise self._damaged("another file is joined to its end")
        except (struct.error, UnicodeDecodeError):
            self._give_up(self._damaged("a record does not fit its length"))
        except RecordError as error:
            self._give_up(error)

    def _give_up(self, error: RecordError) -> None:
        """Raise `error`, or note it where damage is only noted."""
        if self.on_damage is None or self._at <= len(MAGIC):
            raise error from None
        self.on_damage(str(error), self.size - self._at)

    @property
    def channels(self) -> list[McapChannel]:
        """Channels met so far."""
        return list(self._channels.values())

    def _next(self) -> Iterator[McapMessage | McapMetadata]:
        """Read one record of the data section."""
        before = self._crc
        opcode, length = _RECORD.unpack(self._read(_RECORD.size))
        rest = self.size - self._at
        if length > rest:
            if self.on_damage and opcode == Opcode.CHUNK and rest > _CHUNK.size \
                    and length <= _BOUNDS[Opcode.CHUNK]:
                yield from self._cut_chunk(self._read(rest))
                raise self._cut()
            raise self._cut_or_damaged()
        bound = _BOUNDS.get(opcode)
        if bound is None:
            while length > 0:
                length -= len(self._read(min(length, _PIECE)))
            return
        if length > bound:
            raise self._damaged(f"a record of {length} bytes, at most {bound}")
        body = self._read(length)
        if opcode == Opcode.DATA_END:
            (expected,) = struct.unpack("<I", body)
            if self.validate_crcs and expected not in (0, before):
                raise self._damaged("the checksum of its data does not match")
            self._data_end = True
        elif opcode == Opcode.CHUNK:
            yield from self._chunk(body) if self.on_damage is None else self._whole_chunk(body)
        else:
            yield from self._record(opcode, memoryview(body))

    def _chunk(self, body: bytes) -> Iterator[McapMessage | McapMetadata]:
        """Unpack a chunk and read the records in it."""
        _, _, size, crc, text_length = _CHUNK.unpack_from(body)
        if size > MAX_CHUNK_BYTES:
            raise self._damaged(f"a chunk of {size} bytes unpacked, at most {MAX_CHUNK_BYTES}")
        self._total += size
        if self._total > MAX_TOTAL_BYTES:
            raise InvalidRecordError(
                f"{self.name}: more than {MAX_TOTAL_BYTES} bytes unpacked: split the bag"
            )
        start = _CHUNK.size + text_length
        (length,) = struct.unpack_from("<Q", body, start)
        if text_length > 16 or start + 8 + length != len(body):
            raise self._damaged("a chunk does not fit its record")
        method = body[_CHUNK.size:start].decode("ascii", errors="replace")
        data = unpack(body[start + 8:], method, size, f"{self.name}: chunk at {self._at}")
        if self.validate_crcs and crc not in (0, zlib.crc32(data)):
            raise self._damaged("the checksum of a chunk does not match")
        view, at = memoryview(data), 0
        while at < len(data):
            self._records += 1
            if self._records > MOST_RECORDS:
                raise InvalidRecordError(f"{self.name}: more than {MOST_RECORDS} records: split "
                                         "the bag")
            opcode, length = _RECORD.unpack_from(data, at)
            at += _RECORD.size
            if length > len(data) - at or length > _BOUNDS.get(opcode, MAX_CHUNK_BYTES):
                raise self._damaged(f"a record of {length} bytes does not fit its chunk")
            yield from self._record(opcode, view[at:at + length])
            at += length

    def _whole_chunk(self, body: bytes) -> Iterator[McapMessage | McapMetadata]:
        """Read a chunk whole, or note that it is damaged and leave it out."""
        assert self.on_damage is not None
        try:
            items = list(self._chunk(body))
        except (InvalidRecordError, struct.error, UnicodeDecodeError):
            self.on_damage(
                f"{self.name}: the chunk that ends at byte {self._at} is damaged and left out",
                len(body),
            )
            return
        yield from items

    def _cut_chunk(self, body: bytes) -> Iterator[McapMessage | McapMetadata]:
        """Return the messages of a chunk that stand before the cut."""
        _, _, size, _, text_length = _CHUNK.unpack_from(body)
        start = _CHUNK.size + text_length + 8
        if text_length > 16 or size > MAX_CHUNK_BYTES or start > len(body):
            return
        method = body[_CHUNK.size:_CHUNK.size + text_length]
        if method not in (b"zstd", b""):
            return
        data = unpack_zstd_part(body[start:], size) if method else body[start:]
        view, at = memoryview(data), 0
        while at + _RECORD.size <= len(data):
            opcode, length = _RECORD.unpack_from(data, at)
            at += _RECORD.size
            if length > len(data) - at:
                return
            try:
                yield from self._record(opcode, view[at:at + length])
            except (RecordError, struct.error, UnicodeDecodeError):
                return
            at += length

    def _record(self, opcode: int, body: memoryview) -> Iterator[McapMessage | McapMetadata]:
        """Interpret one record of a chunk or of the data section."""
        if opcode == Opcode.MESSAGE:
            number, _, log_time, publish_time = _MESSAGE.unpack_from(body)
            channel = self._channels.get(number)
            if channel is None:
                raise self._damaged(f"a message of channel {number}, which it does not describe")
            if self.topics is None or channel.topic in self.topics:
                yield McapMessage(channel, log_time, publish_time, body[_MESSAGE.size:])
        elif opcode == Opcode.SCHEMA:
            (number,) = struct.unpack_from("<H", body)
            name, at = _text(body, 2)
            encoding, at = _text(body, at)
            (length,) = struct.unpack_from("<I", body, at)
            self._schemas[number] = name, encoding, bytes(body[at + 4:at + 4 + length])
        elif opcode == Opcode.CHANNEL:
            number, schema = struct.unpack_from("<HH", body)
            topic, at = _text(body, 4)
            encoding, at = _text(body, at)
            values = _text_map(body, at)
            name, kind, definition = self._schemas.get(schema, ("", "", b""))
            self._channels[number] = McapChannel(topic, encoding, name, values, kind, definition)
        elif opcode == Opcode.METADATA:
            name, at = _text(body, 0)
            yield McapMetadata(name, _text_map(body, at))
        if max(len(self._channels), len(self._schemas)) > MAX_CHANNELS:
            raise self._damaged(f"more than {MAX_CHANNELS} channels")

    def _read(self, length: int) -> bytes:
        if length > self.size - self._at:
            raise self._cut_or_damaged()
        data = self.file.read(length)
        if len(data) != length:
            raise self._cut()
        self._at += length
        if self.validate_crcs:
            self._crc = zlib.crc32(data, self._crc)
        return data

    def _ends_with_magic(self) -> bool:
        if self.size < 2 * len(MAGIC):
            return False
        self.file.seek(self.size - len(MAGIC))
        return self.file.read(len(MAGIC)) == MAGIC

    def _goes_on(self) -> bool:
        """Whether a magic stands behind the data before that at the end: two files in one."""
        self.file.seek(self._at)
        left, seen = self.size - len(MAGIC) - self._at, b""
        while left > 0 and MAGIC not in seen and (piece := self.file.read(min(left, _PIECE))):
            left -= len(piece)
            seen = seen[-len(MAGIC):] + piece
        return MAGIC in seen

    def _cut_or_damaged(self) -> RecordError:
        """Tell a file that ends too early from one with a wrong length in it."""
        if self._ends_with_magic():
            return self._damaged(f"a record at byte {self._at} is longer than the file")
        return self._cut()

    def _cut(self) -> IncompleteRecordError:
        return IncompleteRecordError(
            f"{self.name}: the recording was cut at byte {self.size}: record the test again"
        )

    def _damaged(self, what: str) -> InvalidRecordError:
        return InvalidRecordError(
            f"{self.name}: damaged near byte {self._at} of {self.size}: {what}; copy the file "
            "again from where it was recorded"
        )


def _text(body: memoryview, at: int) -> tuple[str, int]:
    """Return a length-prefixed text and where it ends."""
    (length,) = struct.unpack_from("<I", body, at)
    end = at + 4 + length
    if end > len(body):
        raise struct.error
    return str(body[at + 4:end], "utf-8"), end


def _text_map(body: memoryview, at: int) -> dict[str, str]:
    """Return the map of texts that begins at `at`."""
    (length,) = struct.unpack_from("<I", body, at)
    at, end = at + 4, at + 4 + length
    if end > len(body):
        raise struct.error
    values = {}
    while at < end:
        key, at = _text(body, at)
        values[key], at = _text(body, at)
    return values
