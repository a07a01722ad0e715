"""Messages of any topic of anybody's bag, MCAP or sqlite3, with the definition of their type."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from ema_record.bag.compression import unpack_zstd_stream
from ema_record.bag.container import (
    METADATA_FILE,
    STORAGE,
    BagFiles,
    find_files,
    full_type,
    opened,
    refuse_unlisted,
    unreadable,
)
from ema_record.bag.mcap_stream import McapMessage, McapStream
from ema_record.errors import InvalidRecordError
from ema_record.limits import MAX_MESSAGE_BYTES, MAX_MESSAGES

STORAGES = ("mcap", "sqlite3")
_SQLITE = b"SQLite format 3\x00"


class AnyTopic(NamedTuple):
    """One topic of a bag."""

    name: str
    type: str
    """With ``/msg/``: ``sensor_msgs/msg/JointState``."""
    encoding: str
    """Of the messages; ``cdr``."""
    schema_encoding: str
    """Of `schema`: ``ros2msg``, ``ros2idl``; empty where the bag holds no definition."""
    schema: str
    messages: int


def is_bag(path: Path) -> bool:
    """Return whether a path looks like a bag: its directory or one of its files."""
    if path.is_dir():
        return (path / METADATA_FILE).is_file() or any(
            p.name.endswith(STORAGE) for p in path.iterdir())
    return path.name.endswith((*STORAGE, ".db3.zstd"))


def list_topics(path: Path) -> dict[str, AnyTopic]:
    """Return the topics of a bag by name.

    Raises
    ------
    InvalidRecordError, IncompleteRecordError
        As `messages_of`.
    """
    found: dict[str, AnyTopic] = {}
    files = _files(path)
    for file in files.paths:
        for topic in _topics_of_file(file, files):
            before = found.get(topic.name, topic._replace(messages=0))
            found[topic.name] = topic._replace(messages=topic.messages + before.messages,
                                               schema=topic.schema or before.schema)
    return found


def messages_of(path: Path, topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
    """Return topic, log time (ns) and bytes of each message, in the order of the files.

    Parameters
    ----------
    path : a rosbag2 directory, an ``.mcap`` or a ``.db3`` file.
    topics : those that are wanted.

    Raises
    ------
    InvalidRecordError, IncompleteRecordError
        No bag; damaged; cut; more than `MAX_MESSAGES` messages of a topic.
    """
    files = _files(path)
    counts = dict.fromkeys(topics, 0)
    for file in files.paths:
        of_file = _of_sqlite if files.storage == "sqlite3" else _of_mcap
        for topic, time, data in of_file(file, topics):
            counts[topic] += 1
            if counts[topic] > MAX_MESSAGES:
                raise InvalidRecordError(f"{file}: more than {MAX_MESSAGES} messages of {topic}: "
                                         "split the bag")
            yield topic, time, data if not files.message_compression else (
                unpack_zstd_stream(data, MAX_MESSAGE_BYTES, topic))


def _files(path: Path) -> BagFiles:
    files = find_files(path, STORAGES)
    refuse_unlisted(path, files.paths)
    packed = next((p for p in files.paths if p.name.endswith(".db3.zstd")), None)
    if packed is not None:
        raise InvalidRecordError(f"{packed}: a compressed sqlite3 file: unpack it with 'zstd -d' "
                                 "and give the .db3 file")
    return files


def _topics_of_file(file: Path, files: BagFiles) -> list[AnyTopic]:
    if files.storage == "sqlite3":
        return _topics_of_sqlite(file)
    counts: dict[str, int] = {}
    try:
        with opened(file) as (stream, size):
            mcap = McapStream(stream, size, str(file))
            for item in mcap:
                if isinstance(item, McapMessage):
                    topic = item.channel.topic
                    counts[topic] = counts.get(topic, 0) + 1
            return [
                AnyTopic(c.topic, full_type(c.schema_name), c.message_encoding, c.schema_encoding,
                         c.schema.decode("utf-8", errors="replace"), counts.get(c.topic, 0))
                for c in mcap.channels]
    except OSError as error:
        raise unreadable(file, error) from None


def _of_mcap(file: Path, topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
    try:
        with opened(file) as (stream, size):
            for item in McapStream(stream, size, str(file), topics):
                if isinstance(item, McapMessage):
                    yield item.channel.topic, item.log_time, bytes(item.data)
    except OSError as error:
        raise unreadable(file, error) from None


def _database(file: Path) -> sqlite3.Connection:
    try:
        with file.open("rb") as stream:
            if stream.read(len(_SQLITE)) != _SQLITE:
                raise InvalidRecordError(f"{file}: no sqlite3 file (it begins otherwise): give a "
                                         "rosbag2 directory, an .mcap or a .db3 file")
    except OSError as error:
        raise unreadable(file, error) from None
    # Read-only; what a recorder that was killed left in the journal is applied in memory only.
    return sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)


def _topics_of_sqlite(file: Path) -> list[AnyTopic]:
    try:
        with closing(_database(file)) as database:
            tables = {str(name) for (name,) in database.execute(
                "SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {"topics", "messages"} <= tables:
                raise InvalidRecordError(f"{file}: a sqlite3 file that is no bag (no table "
                                         "'topics'): give a bag of rosbag2")
            schemas: dict[str, tuple[str, str]] = {}
            if "message_definitions" in tables:
                schemas = {str(name): (str(kind), str(text)) for name, kind, text in
                           database.execute("SELECT topic_type, encoding, "
                                            "encoded_message_definition FROM message_definitions")}
            counts = {int(k): int(n) for k, n in database.execute(
                "SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id")}
            rows = database.execute("SELECT id, name, type, serialization_format FROM topics")
            return [AnyTopic(str(name), full_type(str(kind)), str(encoding),
                             *schemas.get(str(kind), ("", "")), counts.get(int(number), 0))
                    for number, name, kind, encoding in rows]
    except (sqlite3.Error, ValueError, TypeError) as error:
        raise _damaged(file, error) from None


def _of_sqlite(file: Path, topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
    try:
        with closing(_database(file)) as database:
            for topic in sorted(topics):
                for time, data in database.execute(
                        "SELECT timestamp, data FROM messages WHERE topic_id IN (SELECT id FROM "
                        "topics WHERE name = ?) ORDER BY timestamp, id", (topic,)):
                    if not isinstance(data, bytes) or len(data) > MAX_MESSAGE_BYTES:
                        raise InvalidRecordError(f"{file}: {topic}: no message of at most "
                                                 f"{MAX_MESSAGE_BYTES} bytes: the file is damaged")
                    yield topic, int(time), data
    except (sqlite3.Error, ValueError, TypeError) as error:
        raise _damaged(file, error) from None


def _damaged(file: Path, error: Exception) -> InvalidRecordError:
    text = " ".join(str(error).split())[:80]
    return InvalidRecordError(f"{file}: damaged sqlite3 bag ({text}): copy the file again from "
                              "where it was recorded")
