"""Finding and reading the MCAP files of a bag, whoever wrote it."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import IO, Any, NamedTuple

from ema_record.bag.compression import unpack_zstd_stream
from ema_record.bag.mcap_stream import McapMetadata, McapStream
from ema_record.errors import IncompleteRecordError, InvalidRecordError, OutputError, UsageError
from ema_record.files import exists
from ema_record.limits import (
    MAX_FILES,
    MAX_MESSAGE_BYTES,
    MAX_MESSAGES,
    MAX_TOTAL_BYTES,
    MAX_UNPACKED_FILE_BYTES,
)
from ema_record.wire.topics import AIRCRAFT_WIDE, TOPICS, split_name
from ema_record.wire.types import MESSAGE_ENCODING
from ema_record.yaml_file import load_yaml

METADATA_FILE = "metadata.yaml"
MCAP_SUFFIXES = (".mcap", ".mcap.zstd")
STORAGE = (*MCAP_SUFFIXES, ".db3")
"""Endings of the files that hold recorded messages."""


class BagFiles(NamedTuple):
    """The files of a bag in their order, and how their messages are compressed."""

    paths: list[Path]
    message_compression: str
    """``""`` or ``zstd``: of each message, inside its file."""
    counts: dict[str, int]
    """Messages by topic as ``metadata.yaml`` says; empty where it does not."""
    storage: str = "mcap"


class StoredMessage(NamedTuple):
    """One message of a topic."""

    log_time: int
    data: bytes | memoryview


@dataclass
class BagContent:
    """What was read of a bag: messages by topic in order of their log time, and metadata."""

    messages: dict[str, list[StoredMessage]] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    topics: set[str] = field(default_factory=set)
    """All that the bag has, the names of the table without their namespace."""
    namespace: str = ""
    """Of the actuator whose topics they are; empty: none."""


def find_files(path: Path, storages: Sequence[str] = ("mcap",)) -> BagFiles:
    """Return the files of a rosbag2 directory, or of an ``.mcap`` or ``.db3`` file itself.

    Parameters
    ----------
    path : the directory or file.
    storages : those that are read: ``mcap``, ``sqlite3``.

    Raises
    ------
    InvalidRecordError
        Nothing there, no bag, another storage, or a file of the bag is missing.
    IncompleteRecordError
        A recording without ``metadata.yaml``, which is written last.
    """
    try:
        if path.is_dir():
            return _files_of_directory(path, storages)
        if path.is_file():
            return BagFiles([path], "", {}, "sqlite3" if path.suffix == ".db3" else "mcap")
        there = path.exists()
    except OSError as error:
        raise unreadable(path, error) from None
    what = "neither a file nor a directory" if there else "no such file or directory"
    raise InvalidRecordError(f"{path}: {what}: give a rosbag2 directory or an .mcap file")


def check_place(folder: Path, source: Path | None = None) -> None:
    """Raise OutputError where a new folder cannot be: something is there, or it is in a bag.

    `source` : also in this one, which may be cut.
    """
    if folder.exists() or folder.is_symlink():
        raise exists(folder)
    if (folder.parent / METADATA_FILE).is_file() or (
            source is not None and folder.absolute().is_relative_to(source.absolute())):
        raise OutputError(f"{folder}: would lie inside a bag: give a place beside it")


def check_name(bag: Path) -> None:
    """Raise OutputError where no bag can be called so: not UTF-8, or hidden."""
    name = bag.resolve().name
    if name.encode("utf-8", "replace").decode() != name:
        raise OutputError(f"{bag}: the name is not UTF-8, which {METADATA_FILE} cannot hold: "
                          "choose another name")
    if name.startswith("."):
        raise OutputError(f"{bag}: a name that begins with a dot is hidden, and what is hidden is "
                          "not read: choose another name")


def _files_of_directory(path: Path, storages: Sequence[str]) -> BagFiles:
    if (path / METADATA_FILE).is_file():
        return _files_of_metadata(path, storages)
    if any(p.name.endswith(MCAP_SUFFIXES) for p in path.iterdir()):
        raise IncompleteRecordError(
            f"{path}: no {METADATA_FILE}, which is written last: the recording was cut; record "
            "the test again"
        )
    raise InvalidRecordError(
        f"{path}: a directory that is no bag (no {METADATA_FILE}, no .mcap file): give a "
        "rosbag2 directory or an .mcap file"
    )


def _files_of_metadata(path: Path, storages: Sequence[str]) -> BagFiles:
    place = path / METADATA_FILE
    try:
        data = load_yaml(place)
    except UsageError as error:
        raise InvalidRecordError(str(error)) from None
    information: Any = data.get("rosbag2_bagfile_information") if isinstance(data, dict) else None
    names = information.get("relative_file_paths") if isinstance(information, dict) else None
    if not isinstance(names, list) or not 1 <= len(names) <= MAX_FILES:
        raise InvalidRecordError(
            f"{place}: no list of 1 to {MAX_FILES} files under rosbag2_bagfile_information/"
            "relative_file_paths: not written by rosbag2, or damaged"
        )
    storage = information.get("storage_identifier")
    if storage not in storages:
        raise InvalidRecordError(
            f"{path}: storage {str(storage)[:40]!r}, expected {' or '.join(map(repr, storages))}: "
            "convert it with 'ros2 bag convert' or 'rosbags-convert'"
        )
    mode = str(information.get("compression_mode") or "").lower()
    method = str(information.get("compression_format") or "").lower()
    if mode not in ("", "none") and method != "zstd":
        raise InvalidRecordError(
            f"{place}: compression {method[:40]!r} by {mode[:40]}, expected zstd: convert it "
            "with 'ros2 bag convert'"
        )
    paths = [path / PurePosixPath(str(name)).name for name in names]
    for file in paths:
        if not file.is_file():
            raise InvalidRecordError(f"{file}: named by {METADATA_FILE} and missing: copy it too")
    refuse_links(path, paths)
    return BagFiles(paths, "zstd" if mode == "message" else "", _counts(information), storage)


def refuse_links(bag: Path, files: list[Path]) -> None:
    """Raise InvalidRecordError where a file of the bag lies outside its directory."""
    inside = bag.resolve()
    for file in files:
        if file.resolve().parent != inside:
            raise InvalidRecordError(f"{file}: a link out of the bag: copy the file into the bag")


def refuse_unlisted(bag: Path, files: list[Path]) -> None:
    """Raise InvalidRecordError where a directory has messages beside its `files`.

    Unread they could be a part of the record. One that a player has unpacked is no other.
    """
    listed = {file.name.removesuffix(".zstd") for file in files}
    try:
        there = sorted(bag.iterdir()) if bag.is_dir() else []
    except OSError as error:
        raise unreadable(bag, error) from None
    for other in there:
        if (other.name.endswith(STORAGE) and not other.name.startswith(".")
                and other.name.removesuffix(".zstd") not in listed):
            raise InvalidRecordError(
                f"{other}: not named by {METADATA_FILE}: move it out of the bag, or if it is a "
                "part of it make the list anew with 'ros2 bag reindex'")


def _counts(information: dict[str, Any]) -> dict[str, int]:
    """Return the numbers of messages by topic, as far as they are there."""
    counts: dict[str, int] = {}
    rows = information.get("topics_with_message_count")
    for row in rows if isinstance(rows, list) else []:
        topic = row.get("topic_metadata") if isinstance(row, dict) else None
        if isinstance(topic, dict) and type(row.get("message_count")) is int:
            counts[split_name(str(topic.get("name"))).topic] = row["message_count"]
    return counts


def read_content(
    path: Path, topics: frozenset[str], *, validate_crcs: bool = True, file_order: bool = False
) -> BagContent:
    """Return the messages of `topics`, sorted by log time, and all metadata.

    With `file_order` they are left in the order of the file. The topics of an actuator may stand
    under its namespace.

    Raises
    ------
    InvalidRecordError, IncompleteRecordError
        See `find_files`, `refuse_unlisted` and `mcap_stream.McapStream`; a topic of another
        type; too many messages; topics of several actuators.
    """
    files = find_files(path)
    refuse_unlisted(path, files.paths)
    content = BagContent()
    namespaces: set[str] = set()
    for file in files.paths:
        try:
            with opened(file) as (stream, size):
                mcap = McapStream(stream, size, str(file), _InAnyNamespace(topics), validate_crcs)
                for item in mcap:
                    if isinstance(item, McapMetadata):
                        content.metadata[item.name] = item.values
                        continue
                    topic = split_name(item.channel.topic).topic
                    messages = content.messages.get(topic)
                    if messages is None:
                        messages = content.messages.setdefault(topic, [])
                    if len(messages) >= MAX_MESSAGES:
                        raise InvalidRecordError(
                            f"{file}: more than {MAX_MESSAGES} messages of {topic}: publish "
                            "larger blocks"
                        )
                    messages.append(StoredMessage(item.log_time, item.data))
                _check_types(mcap, topics)
                for name in (split_name(channel.topic) for channel in mcap.channels):
                    content.topics.add(name.topic)
                    if name.topic in topics - AIRCRAFT_WIDE:
                        namespaces.add(name.namespace)
        except OSError as error:
            raise unreadable(file, error) from None
    if len(namespaces) > 1:
        names = ", ".join(sorted(name or "/" for name in namespaces))[:120]
        raise InvalidRecordError(
            f"{path}: holds the topics of several actuators ({names}), expected one: record each "
            "in a bag of its own, or split it with 'ros2 bag convert'"
        )
    content.namespace = "".join(namespaces)
    for topic in topics & files.counts.keys():
        read = len(content.messages.get(topic, []))
        if read != files.counts[topic]:
            why = ("a file of the bag is missing in its list" if read < files.counts[topic]
                   else "it is that of another bag, or was edited")
            raise InvalidRecordError(
                f"{path}: {read} messages on {topic}, {METADATA_FILE} counts "
                f"{files.counts[topic]}: {why}; copy it again"
            )
    room = MAX_TOTAL_BYTES
    for topic, messages in content.messages.items():
        if not file_order:
            messages.sort(key=lambda message: message.log_time)
        for k, message in enumerate(messages if files.message_compression else ()):
            data = unpack_zstd_stream(bytes(message.data), min(MAX_MESSAGE_BYTES, room), topic)
            messages[k], room = message._replace(data=data), room - len(data)
    return content


class _InAnyNamespace:
    """The names of topics of the table, under whatever namespace."""

    def __init__(self, topics: frozenset[str]) -> None:
        self._topics = topics

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and split_name(name).topic in self._topics


def _check_types(mcap: McapStream, topics: frozenset[str]) -> None:
    """Check the type and the encoding of every topic that is used."""
    for channel in mcap.channels:
        topic = split_name(channel.topic).topic
        if topic not in topics:
            continue
        expected = TOPICS[topic].type
        found = full_type(channel.schema_name)
        if found != expected or channel.message_encoding != MESSAGE_ENCODING:
            raise InvalidRecordError(
                f"{mcap.name}: {channel.topic} is {found[:60]!r} in "
                f"{channel.message_encoding[:20]!r}, expected {expected!r} in "
                f"{MESSAGE_ENCODING!r}: record the topics of the actuator's test"
            )


def full_type(name: str) -> str:
    """Return the name of a message type with ``/msg/``, as it was written or without."""
    return re.sub(r"^(\w+)/(\w+)$", r"\1/msg/\2", name)


@contextmanager
def opened(file: Path) -> Iterator[tuple[IO[bytes], int]]:
    """Open a file; one that is compressed as a whole is unpacked in memory."""
    with file.open("rb") as stream:
        if file.name.endswith(".zstd"):
            if file.stat().st_size > MAX_UNPACKED_FILE_BYTES:
                raise InvalidRecordError(
                    f"{file}: {file.stat().st_size} bytes, at most {MAX_UNPACKED_FILE_BYTES}: "
                    "unpack it with 'zstd -d'"
                )
            data = unpack_zstd_stream(stream.read(), MAX_UNPACKED_FILE_BYTES, str(file))
            yield io.BytesIO(data), len(data)
        else:
            yield stream, file.stat().st_size


def unreadable(path: Path, error: OSError) -> InvalidRecordError:
    """Return the error for a file that the operating system does not give."""
    return InvalidRecordError(
        f"{path}: cannot be read ({error.strerror or error}): check its permissions"
    )
