"""Rig bags: a rosbag2 directory with `/ema/samples` in the rig's channels, and its axis.

Same container as the bag of the actuator's test; the description of the axis is the MCAP
metadata record `RIG`.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from pydantic import ValidationError

from ema_record.bag.container import METADATA_FILE, BagContent, read_content
from ema_record.bag.metadata import (
    ROSBAG2,
    BagSummary,
    bagfile_information,
    metadata_yaml,
    rosbag2_record,
)
from ema_record.bag.qos import offered_qos_profiles
from ema_record.bag.writer import CHUNK_SIZE, LIBRARY, MCAP_PROFILE
from ema_record.channels import Channel
from ema_record.errors import InvalidRecordError, first_problem
from ema_record.files import cannot_write, make_new_directory, new_file
from ema_record.limits import MAX_MESSAGE_BYTES
from ema_record.version import VERSION
from ema_record.wire.schemas import MESSAGE_ENCODING, SCHEMA_ENCODING, definition, type_hash
from ema_record.wire.topics import SAMPLES, TOPICS
from ema_record.wire.types import NANOSECONDS, deserialize, message_class, serialize
from ema_rig.record import MAX_RIG_SAMPLES, Axis, RigRecord

RIG = "ema_phm.rig"
"""Name of the MCAP metadata record that describes the axis."""
BLOCK = 500
"""Samples a message."""
_TYPE = TOPICS[SAMPLES].type


def write_rig_bag(record: RigRecord, path: str | Path) -> Path:
    """Write a rig's record as a bag, the same bytes for the same record.

    Log times are those of the record, counted from the epoch where they are negative.

    Raises
    ------
    OutputError
        `path` exists, or cannot be written.

    """
    directory = Path(path)
    make_new_directory(directory)
    file = directory / f"{directory.resolve().name}_0.mcap"
    topic = TOPICS[SAMPLES]
    shift = min(0.0, float(record.time[0]))
    stamps: list[int] = []
    try:
        with file.open("xb") as stream:
            mcap = Writer(stream, chunk_size=CHUNK_SIZE, enable_data_crcs=True)
            mcap.start(profile=MCAP_PROFILE, library=LIBRARY)
            mcap.add_metadata(RIG, {"axis": record.axis.model_dump_json(),
                                    "software_version": VERSION})
            schema = mcap.register_schema(_TYPE, SCHEMA_ENCODING, definition(_TYPE).encode())
            channel = mcap.register_channel(topic.name, MESSAGE_ENCODING, schema, {
                "offered_qos_profiles": offered_qos_profiles(topic.qos),
                "topic_type_hash": type_hash(_TYPE),
            })
            for first in range(0, len(record), BLOCK):
                block = record.samples[first:first + BLOCK]
                stamp = int(np.rint((block[-1, 0] - shift) * NANOSECONDS))
                stamps.append(stamp)
                mcap.add_message(channel, stamp, _encode(block, record.channels), stamp,
                                 sequence=len(stamps))
            information = bagfile_information(BagSummary(
                file_name=file.name, counts=[(topic, len(stamps))], first=stamps[0],
                last=stamps[-1],
                custom_data={"rig": record.axis.name, "software_version": VERSION},
            ))
            mcap.add_metadata(ROSBAG2, rosbag2_record(information))
            mcap.finish()
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        raise cannot_write(file, error) from None
    with new_file(directory / METADATA_FILE) as temporary:
        temporary.write_text(metadata_yaml(information), encoding="utf-8")
    return directory


def _encode(block: np.ndarray, channels: tuple[Channel, ...]) -> bytes:
    """Return a block as a serialised std_msgs/Float64MultiArray."""
    dimension = message_class("std_msgs/msg/MultiArrayDimension")
    layout = message_class("std_msgs/msg/MultiArrayLayout")(
        dim=[dimension(label="sample", size=len(block), stride=block.size),
             dimension(label=",".join(c.label for c in channels), size=len(channels),
                       stride=len(channels))],
        data_offset=0,
    )
    return serialize(message_class(_TYPE)(layout=layout, data=block.ravel()), _TYPE)


def is_rig_bag(path: str | Path) -> bool:
    """Return whether a bag describes a rig; damaged bags raise as in `read_rig_bag`."""
    return RIG in read_content(Path(path), frozenset(), validate_crcs=False).metadata


def read_rig_bag(path: str | Path) -> RigRecord:
    """Return the record that a rig bag holds.

    Raises
    ------
    InvalidRecordError
        No bag, damaged, or not a rig's.
    IncompleteRecordError
        The recording was cut.

    """
    source = str(path)
    content = read_content(Path(path), frozenset({SAMPLES}))
    axis = _axis(content, source)
    blocks: list[np.ndarray] = []
    channels: tuple[Channel, ...] = ()
    count = 0
    for message in content.messages.get(SAMPLES, []):
        block, found = _decode(message.data, source)
        if channels and found != channels:
            raise InvalidRecordError(f"{source}: {SAMPLES} changes its channels: split the bag")
        channels = found
        count += len(block)
        if count > MAX_RIG_SAMPLES:
            raise InvalidRecordError(f"{source}: more than {MAX_RIG_SAMPLES} samples: split the "
                                     "bag")
        blocks.append(block)
    if not count:
        raise InvalidRecordError(f"{source}: no message on {SAMPLES}: import the file again")
    return RigRecord(samples=np.concatenate(blocks), channels=channels, axis=axis, source=source)


def _axis(content: BagContent, source: str) -> Axis:
    values = content.metadata.get(RIG)
    if values is None:
        raise InvalidRecordError(
            f"{source}: does not describe a rig (no metadata record {RIG!r}): it may be a bag of "
            "the actuator's own test; import a rig's file with 'ema import'"
        )
    try:
        return Axis.model_validate_json(values.get("axis", ""))
    except ValidationError as error:
        text = first_problem(error, source, "description of the axis",
                             "the bag was edited or damaged")
        raise InvalidRecordError(text) from None


def _decode(data: bytes | memoryview, source: str) -> tuple[np.ndarray, tuple[Channel, ...]]:
    """Return the samples of one message and their channels."""
    if len(data) > MAX_MESSAGE_BYTES:
        raise InvalidRecordError(f"{source}: message of {len(data)} bytes on {SAMPLES}")
    message = deserialize(data, _TYPE, SAMPLES)
    dims = message.layout.dim
    if len(dims) != 2 or dims[0].size * dims[1].size != len(message.data) \
            or message.layout.data_offset:
        raise InvalidRecordError(f"{source}: {SAMPLES} holds {len(message.data)} numbers in "
                                 f"{len(dims)} dimensions, expected [sample, channel]")
    channels = []
    for label in str(dims[1].label).split(","):
        name, _, unit = label.strip().partition("[")
        channels.append(Channel(name, unit.removesuffix("]")))
    if len(channels) != dims[1].size:
        raise InvalidRecordError(f"{source}: {len(channels)} names for {dims[1].size} channels "
                                 f"on {SAMPLES}")
    values = np.asarray(message.data, dtype=np.float64)
    return values.reshape(dims[0].size, dims[1].size), tuple(channels)
