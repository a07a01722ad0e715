"""Rig bags: a rosbag2 directory with `/ema/samples` in the rig's channels, and its axis.

Same container as the bag of the actuator's test; the description of the axis is the MCAP
metadata record `RIG`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ema_record.bag.container import BagContent, read_content
from ema_record.bag.metadata import RIG
from ema_record.bag.read import read_bag
from ema_record.bag.writer import RawBag
from ema_record.channels import Channel
from ema_record.errors import InvalidRecordError, UsageError, validated
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_record.version import VERSION
from ema_record.wire.samples import BLOCK_SIZE, decode_labelled, encode_block
from ema_record.wire.topics import SAMPLES, TOPICS
from ema_record.wire.types import NANOSECONDS
from ema_rig.record import MAX_RIG_SAMPLES, Axis, RigRecord


def write_rig_bag(record: RigRecord, path: str | Path) -> Path:
    """Write a rig's record as a bag, the same bytes for the same record.

    Log times are those of the record, counted from the epoch where they are negative.

    Raises
    ------
    OutputError
        `path` exists, or cannot be written.
    UsageError
        Times that no log time holds.
    """
    if np.abs(record.time).max() * NANOSECONDS >= 2.0**62:
        raise UsageError(f"times up to {np.abs(record.time).max():.3g} s: at most 4.6e9 s; count "
                         "them from the first sample")
    bag = RawBag(
        path, topics=[TOPICS[SAMPLES]],
        records={RIG: {"axis": record.axis.model_dump_json(exclude_none=True),
                       "software_version": VERSION}},
    )
    shift = min(0.0, float(record.time[0]))
    label = ",".join(channel.label for channel in record.channels)
    with bag.whole():
        for first in range(0, len(record), BLOCK_SIZE):
            block = record.samples[first:first + BLOCK_SIZE]
            stamp = int(np.rint((block[-1, 0] - shift) * NANOSECONDS))
            bag.write_raw(SAMPLES, encode_block(block, label), stamp)
        return bag.finish({}, {"rig": record.axis.name, "software_version": VERSION})


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
    label = ""
    count = 0
    for message in content.messages.get(SAMPLES, []):
        try:
            found, block = decode_labelled(message.data)
        except InvalidRecordError as error:
            raise InvalidRecordError(f"{source}: {error}") from None
        if label and found != label:
            raise InvalidRecordError(f"{source}: {SAMPLES} changes its channels: split the bag")
        label = found
        count += len(block)
        if count > MAX_RIG_SAMPLES:
            raise InvalidRecordError(f"{source}: more than {MAX_RIG_SAMPLES} samples: split the "
                                     "bag")
        blocks.append(block)
    if not count:
        raise InvalidRecordError(f"{source}: no message on {SAMPLES}: import the file again")
    parts = [name.strip().partition("[") for name in label.split(",")]
    channels = tuple(Channel(name, unit.removesuffix("]")) for name, _, unit in parts)
    return RigRecord(samples=np.concatenate(blocks), channels=channels, axis=axis, source=source)


def _axis(content: BagContent, source: str) -> Axis:
    values = content.metadata.get(RIG)
    if values is None:
        raise InvalidRecordError(
            f"{source}: does not describe a rig (no metadata record {RIG!r}): it may be a bag of "
            "the actuator's own test; import a rig's file with 'ema import'"
        )
    return validated(Axis.model_validate_json, values.get("axis", ""), source,
                     "description of the axis", "the bag was edited or damaged",
                     kind=InvalidRecordError)


def read_any(path: str | Path, profile: str | Path | None = None) -> Record | RigRecord:
    """Return the record of a bag, with the test `profile` in place of its own.

    Raises
    ------
    RecordError
        It cannot be read; of a file of another kind the error says how to import it.
    """
    from ema_rig.ros_bag import how_to_import

    path = Path(path)
    foreign = how_to_import(path)
    if foreign is not None:
        raise foreign
    if is_rig_bag(path):
        return read_rig_bag(path)
    record = read_bag(path)
    return record if profile is None else replace(record, profile=load_profile(profile))
