"""What can still be read of a bag that was cut or damaged.

Chunks are the unit: one whose checksum does not match is left out and reading goes on after
it; of one that the end of the file cuts, the messages before the cut are kept.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, field
from pathlib import Path

from ema_record.bag.compression import unpack_zstd_part
from ema_record.bag.container import MCAP_SUFFIXES, METADATA_FILE, refuse_links
from ema_record.bag.mcap_stream import McapMessage, McapMetadata, McapStream
from ema_record.errors import IncompleteRecordError, InvalidRecordError
from ema_record.limits import (
    MAX_FILES,
    MAX_MESSAGE_BYTES,
    MAX_MESSAGES,
    MAX_UNPACKED_FILE_BYTES,
)

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
        No bag, a file that is no MCAP file, or a link out of the bag.
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
    files = [p for p in path.iterdir() if p.name.endswith(MCAP_SUFFIXES) and p.is_file()]
    if not 1 <= len(files) <= MAX_FILES:
        raise InvalidRecordError(
            f"{path}: {len(files)} .mcap files, expected 1 to {MAX_FILES}: give the directory of "
            "one bag"
        )
    refuse_links(path, files)
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
            data = unpack_zstd_part(stream.read(MAX_UNPACKED_FILE_BYTES), MAX_UNPACKED_FILE_BYTES)
            mcap = McapStream(
                io.BytesIO(data), len(data), file.name, on_damage=found.damaged)
        else:
            mcap = McapStream(stream, size, file.name, on_damage=found.damaged)
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
    data = unpack_zstd_part(bytes(message.data), MAX_MESSAGE_BYTES)
    return message._replace(data=memoryview(data))
