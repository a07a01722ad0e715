"""What can still be read of a bag that was cut or damaged.

Chunks are the unit: one whose checksum does not match is left out and reading goes on after
it; of one that the end of the file cuts, the messages before the cut are kept.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import zstandard

from ema_record.bag.mcap_stream import McapMessage, McapMetadata, McapStream
from ema_record.bag.metadata import METADATA_FILE
from ema_record.errors import IncompleteRecordError, InvalidRecordError, RecordError
from ema_record.limits import (
    MAX_CHUNK_BYTES,
    MAX_FILES,
    MAX_MESSAGE_BYTES,
    MAX_MESSAGES,
    MAX_UNPACKED_FILE_BYTES,
)

_MCAP_SUFFIXES = (".mcap", ".mcap.zstd")
_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_CHUNK_OPCODE = 6
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MAX_DAMAGES = 20


@dataclass
class Salvage:
    """What was read of one bag.

    Attributes
    ----------
    messages : list of McapMessage
        In the order of the files.
    metadata : dict
        Values of each metadata record by its name.
    damages : list of str
        What could not be read, one line each.
    unread : int
        Bytes of the files that could not be read.
    whole : bool
        Nothing was cut or damaged, and ``metadata.yaml`` is there.

    """

    messages: list[McapMessage] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    damages: list[str] = field(default_factory=list)
    unread: int = 0
    whole: bool = True

    def damaged(self, what: str, unread: int = 0) -> None:
        """Note something that could not be read."""
        self.whole = False
        self.unread += unread
        if len(self.damages) < _MAX_DAMAGES:
            self.damages.append(what)


def salvage_bag(path: Path) -> Salvage:
    """Read what is left of a bag directory or of an ``.mcap`` file; nothing is changed.

    Raises
    ------
    InvalidRecordError
        No bag, or a file that is no MCAP file.
    IncompleteRecordError
        Cut before anything was recorded.

    """
    found = Salvage()
    for file in _files(path, found):
        try:
            _salvage_file(file, found)
        except OSError as error:
            raise InvalidRecordError(
                f"{file}: cannot be read ({error.strerror or error}): check the file and its "
                "permissions"
            ) from None
        except MemoryError:
            found.damaged(f"{file.name}: not enough memory to unpack it", file.stat().st_size)
    if not found.messages and not found.metadata:
        raise IncompleteRecordError(
            f"{path}: cut before anything was recorded: record the test again"
        )
    return found


def _files(path: Path, found: Salvage) -> list[Path]:
    """Return the MCAP files at `path`, numbered ones in the order of their numbers."""
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise InvalidRecordError(
            f"{path}: no such file or directory: give a rosbag2 directory or an .mcap file"
        )
    files = [p for p in path.iterdir() if p.name.endswith(_MCAP_SUFFIXES) and p.is_file()]
    if not 1 <= len(files) <= MAX_FILES:
        raise InvalidRecordError(
            f"{path}: {len(files)} .mcap files, expected 1 to {MAX_FILES}: give the directory of "
            "one bag"
        )
    if not (path / METADATA_FILE).is_file():
        found.damaged(f"no {METADATA_FILE}: the recorder did not finish")
    return sorted(files, key=_number)


def _number(file: Path) -> tuple[int, str]:
    match = re.search(r"_(\d{1,9})\.mcap", file.name)
    return (int(match[1]) if match else -1, file.name)


def _salvage_file(file: Path, found: Salvage) -> None:
    """Add what can be read of one file to `found`."""
    with file.open("rb") as stream:
        size = file.stat().st_size
        if file.name.endswith(".zstd"):
            data = _unpacked_part(stream.read(MAX_UNPACKED_FILE_BYTES), MAX_UNPACKED_FILE_BYTES)
            mcap = _SalvagingStream(io.BytesIO(data), len(data), file.name, found)
        else:
            mcap = _SalvagingStream(stream, size, file.name, found)
        for item in mcap:
            if isinstance(item, McapMetadata):
                found.metadata[item.name] = item.values
            elif len(found.messages) < MAX_MESSAGES:
                found.messages.append(_unpacked_message(item))
            else:
                found.damaged(f"{file.name}: more than {MAX_MESSAGES} messages")
                return


def _unpacked_message(message: McapMessage) -> McapMessage:
    """Return a message, unpacked where its recorder compressed each message by itself."""
    if bytes(message.data[:4]) != _ZSTD_MAGIC:
        return message
    data = _unpacked_part(bytes(message.data), MAX_MESSAGE_BYTES)
    return message._replace(data=memoryview(data))


def _unpacked_part(data: bytes, bound: int) -> bytes:
    """Return the beginning of a zstd stream, as far as it goes, at most `bound` bytes."""
    parts: list[bytes] = []
    total = 0
    try:
        with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
            while total < bound:
                part = reader.read(min(1 << 16, bound - total))
                if not part:
                    break
                parts.append(part)
                total += len(part)
    except zstandard.ZstdError:
        pass  # what came before the damage stays
    return b"".join(parts)


class _SalvagingStream(McapStream):
    """An MCAP file read as far as it goes; what is wrong is noted, not raised."""

    def __init__(self, file: io.IOBase, size: int, name: str, found: Salvage) -> None:
        super().__init__(file, size, name)  # type: ignore[arg-type]
        self._found = found

    def __iter__(self) -> Iterator[McapMessage | McapMetadata]:
        """Return messages and metadata; only a file that is no MCAP file raises."""
        read = iter(super().__iter__())
        while True:
            before = self._at
            try:
                yield next(read)
            except StopIteration:
                return
            except RecordError as error:
                if self._at <= 8:
                    raise
                self._found.damaged(str(error), max(0, self.size - max(before, self._at)))
                return

    def _next(self) -> Iterator[McapMessage | McapMetadata]:
        """Read one record; of a chunk that is cut, the messages before the cut."""
        if self.size - self._at > _RECORD.size + _CHUNK.size:
            here = self.file.tell()
            opcode, length = _RECORD.unpack(self.file.read(_RECORD.size))
            body = self.size - self._at - _RECORD.size
            if opcode == _CHUNK_OPCODE and body < length <= MAX_CHUNK_BYTES + 256:
                yield from self._cut_chunk(self.file.read(body))
                self._at = self.size
                raise self._cut()
            self.file.seek(here)
        try:
            yield from super()._next()
        except (struct.error, UnicodeDecodeError):
            raise self._damaged("a record does not fit its length") from None

    def _chunk(self, body: bytes) -> Iterator[McapMessage | McapMetadata]:
        """Read a chunk whole, or note that it is damaged and leave it out."""
        try:
            items = list(super()._chunk(body))
        except (InvalidRecordError, struct.error, UnicodeDecodeError):
            self._found.damaged(
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
        method = body[_CHUNK.size:_CHUNK.size + text_length].decode("ascii", errors="replace")
        if method == "zstd":
            data = _unpacked_part(body[start:], size)
        elif method == "":
            data = body[start:]
        else:
            return
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
