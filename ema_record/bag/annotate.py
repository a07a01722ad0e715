"""`add_last_message`: a message after the last one of a bag that is finished, as its verdict is.

The file is copied up to its end, continued, and renamed over the old one; then ``metadata.yaml``,
in the same way. Whatever happens in between, what is there is a whole bag, with the message or
without it.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    SummaryOffset,
)

from ema_record.bag.container import METADATA_FILE, find_files
from ema_record.bag.mcap_stream import MAGIC
from ema_record.bag.metadata import (
    ROSBAG2,
    channel_metadata,
    metadata_yaml,
    rosbag2_record,
    topic_row,
)
from ema_record.errors import InvalidRecordError
from ema_record.files import cannot_write, sync_directory
from ema_record.limits import MAX_MESSAGE_BYTES
from ema_record.wire.topics import Topic
from ema_record.wire.types import MESSAGE_ENCODING, SCHEMA_ENCODING, definition
from ema_record.yaml_file import load_yaml

VERDICT = "ema_phm.verdict"
"""Name of the MCAP metadata record with what the message says in short."""
ATTACHED, JSON = "verdict.json", "application/json"
"""Name and kind of the MCAP attachment with all of it."""
_DATA_END, _FOOTER = 9 + 4, 9 + 20 + len(MAGIC)
"""Lengths of the records at the end of the data and of the file (bytes)."""


def add_last_message(
    bag: Path, topic: Topic, data: bytes, log_time: int, said: Mapping[str, str],
    attached: bytes = b"",
) -> None:
    """Add a message on a topic that the bag does not have, later than all others.

    Parameters
    ----------
    bag : a whole bag of one file, as `BagWriter` leaves it.
    topic : as it is called in the bag.
    data : CDR with its encapsulation.
    log_time : reception (ns since the epoch).
    said : for the metadata of file and directory.
    attached : JSON, for an attachment of the file.

    Raises
    ------
    InvalidRecordError
        The bag is none of ours, or has that topic.
    OutputError
        It cannot be written; it is as it was.
    """
    place = bag / METADATA_FILE
    files = find_files(bag).paths
    content: Any = load_yaml(place)
    information = content["rosbag2_bagfile_information"]
    rows = information["topics_with_message_count"]
    if len(files) != 1 or any(row["topic_metadata"]["name"] == topic.name for row in rows):
        raise InvalidRecordError(f"{bag}: has more than one file, or {topic.name} already")
    if not 4 <= len(data) <= MAX_MESSAGE_BYTES:
        raise InvalidRecordError(f"{topic.name}: message of {len(data)} bytes")
    _count(information, topic, log_time, said)
    try:
        _replace(files[0], _continued(files[0], topic, data, log_time, {
            VERDICT: dict(said), ROSBAG2: rosbag2_record(information),
        }, attached))
        _replace(place, metadata_yaml(information).encode())
    except OSError as error:
        raise cannot_write(bag, error) from None


def _count(
    information: dict[str, Any], topic: Topic, log_time: int, said: Mapping[str, str]
) -> None:
    """Bring rosbag2's metadata up to date."""
    information["topics_with_message_count"].append(topic_row(topic, 1))
    for part in (information, information["files"][0]):
        first = part["starting_time"]["nanoseconds_since_epoch"]
        part["duration"] = {
            "nanoseconds": max(part["duration"]["nanoseconds"], log_time - first)}
        part["message_count"] += 1
    information["custom_data"] = {**(information["custom_data"] or {}), **said}


def _continued(
    file: Path, topic: Topic, data: bytes, log_time: int, records: Mapping[str, dict[str, str]],
    attached: bytes,
) -> bytes:
    """Return a finished MCAP file with one chunk, some metadata and an attachment more."""
    old = file.read_bytes()
    try:
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
    except McapError as error:
        raise InvalidRecordError(f"{file}: {error}") from None
    start = int.from_bytes(old[-_FOOTER + 9:-_FOOTER + 17], "little")
    if summary is None or summary.statistics is None or not start:
        raise InvalidRecordError(f"{file}: has no summary")
    body = bytearray(old[:start - _DATA_END])
    log_time = max(log_time, summary.statistics.message_end_time)

    schema = next((s for s in summary.schemas.values() if s.name == topic.type), None)
    if schema is None:
        schema = Schema(id=max(summary.schemas, default=0) + 1, name=topic.type,
                        encoding=SCHEMA_ENCODING, data=definition(topic.type).encode())
    channel = Channel(
        id=max(summary.channels, default=0) + 1, topic=topic.name,
        message_encoding=MESSAGE_ENCODING, schema_id=schema.id,
        metadata=channel_metadata(topic))
    inside = RecordBuilder()
    schema.write(inside)
    channel.write(inside)
    at = inside.count
    Message(channel_id=channel.id, log_time=log_time, publish_time=log_time, sequence=1,
            data=data).write(inside)
    index = MessageIndex(channel_id=channel.id, records=[(log_time, at)])
    summary.chunk_indexes.append(_add_chunk(body, inside.end(), index, log_time))
    if attached:
        summary.attachment_indexes.append(_attach(body, attached, log_time))
    for name, values in records.items():
        offset, written = len(body), _written(Metadata(name=name, metadata=values))
        body += written
        summary.metadata_indexes[:] = [m for m in summary.metadata_indexes if m.name != name]
        summary.metadata_indexes.append(MetadataIndex(offset, len(written), name))
    statistics = summary.statistics
    statistics.message_count += 1
    statistics.chunk_count += 1
    statistics.schema_count += schema.id not in summary.schemas
    statistics.channel_count += 1
    statistics.metadata_count += len(records)
    statistics.attachment_count = len(summary.attachment_indexes)
    statistics.message_end_time = log_time
    statistics.channel_message_counts[channel.id] = 1
    body += _written(DataEnd(zlib.crc32(body)))
    _add_summary(body, [
        (Opcode.SCHEMA, [*summary.schemas.values(),
                         *([] if schema.id in summary.schemas else [schema])]),
        (Opcode.CHANNEL, [*summary.channels.values(), channel]),
        (Opcode.STATISTICS, [statistics]),
        (Opcode.CHUNK_INDEX, summary.chunk_indexes),
        (Opcode.ATTACHMENT_INDEX, summary.attachment_indexes),
        (Opcode.METADATA_INDEX, summary.metadata_indexes),
    ])
    return bytes(body)


def _written(record: Any) -> bytes:
    """Return a record of MCAP as bytes."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _add_chunk(body: bytearray, inside: bytes, index: MessageIndex, log_time: int) -> ChunkIndex:
    """Append a chunk of one message with its index."""
    packed = zstandard.compress(inside)
    offset, written = len(body), _written(Chunk(
        compression="zstd", data=packed, message_start_time=log_time, message_end_time=log_time,
        uncompressed_crc=zlib.crc32(inside), uncompressed_size=len(inside),
    ))
    body += written
    at, indexed = len(body), _written(index)
    body += indexed
    return ChunkIndex(
        message_start_time=log_time, message_end_time=log_time, chunk_start_offset=offset,
        chunk_length=len(written), message_index_offsets={index.channel_id: at},
        message_index_length=len(indexed), compression="zstd", compressed_size=len(packed),
        uncompressed_size=len(inside),
    )


def _attach(body: bytearray, data: bytes, log_time: int) -> AttachmentIndex:
    """Append an attachment."""
    offset, written = len(body), _written(Attachment(
        create_time=log_time, log_time=log_time, name=ATTACHED, media_type=JSON, data=data))
    body += written
    return AttachmentIndex(
        offset=offset, length=len(written), create_time=log_time, log_time=log_time,
        data_size=len(data), name=ATTACHED, media_type=JSON)


def _add_summary(body: bytearray, groups: list[tuple[Opcode, list[Any]]]) -> None:
    """Append the summary section, the footer and the end of the file."""
    start = len(body)
    offsets = []
    for opcode, records in groups:
        if not records:
            continue
        at = len(body)
        for record in records:
            body += _written(record)
        offsets.append(SummaryOffset(opcode, at, len(body) - at))
    offset_start = len(body)
    for offset in offsets:
        body += _written(offset)
    footer = _written(Footer(start, offset_start, 0))
    crc = zlib.crc32(footer[:-4], zlib.crc32(body[start:]))
    body += _written(Footer(start, offset_start, crc)) + MAGIC


def _replace(path: Path, data: bytes) -> None:
    """Put a whole new file in the place of an old one, or leave that."""
    temporary = path.with_name(f".{path.name}.new")
    try:
        with temporary.open("wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_directory(path.parent)
