"""`read_bag` and `write_bag`: a `Record` from and to a rosbag2 directory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ema_record.bag.container import BagContent, StoredMessage, read_content
from ema_record.bag.metadata import TestMetadata, read_test_metadata
from ema_record.bag.writer import CHUNK_SIZE, BagWriter
from ema_record.channels import SURFACE_POSITION, TIME
from ema_record.errors import IncompleteRecordError, InvalidRecordError, UsageError
from ema_record.limits import MAX_DURATION, MAX_RATE, MAX_SAMPLES
from ema_record.profile import Profile
from ema_record.record import Record
from ema_record.wire.samples import BLOCK_SIZE, decode_block, encode_block
from ema_record.wire.sensors import (
    BATTERY_STATE,
    TEMPERATURE,
    bus_reading,
    encode_bool,
    encode_dc_bus,
    encode_temperature,
)
from ema_record.wire.topics import (
    COMMAND,
    DC_BUS,
    JOINT_STATES,
    PHASE_CURRENTS,
    SAMPLES,
    WEIGHT_ON_WHEELS,
    WINDING_TEMPERATURE,
)
from ema_record.wire.trajectory import decode_command, encode_command, trajectory_points
from ema_record.wire.types import NANOSECONDS, deserialize, stamp_of
from ema_record.wire.views import views_of

_READ_TOPICS = frozenset({SAMPLES, COMMAND, DC_BUS, WINDING_TEMPERATURE})


def read_bag(
    path: str | Path, *, validate_crcs: bool = True, validate_values: bool = True
) -> Record:
    """Return the record that a bag holds.

    Parameters
    ----------
    path : path-like
        A rosbag2 directory of any conforming recorder, or a single ``.mcap`` file.
    validate_crcs : bool
        Compare the checksums of the file.
    validate_values : bool
        Refuse samples that are not finite or whose time does not increase. Without it they
        are left to the caller, as the record checks of the built-in test do.

    Returns
    -------
    Record
        A bag without our own metadata has the profile and the start time of its
        `/ema/command`. The status of an aborted test is ``aborted`` in its provenance; it
        reads like any other.

    Raises
    ------
    InvalidRecordError
        No bag, damaged, or not a record of the actuator's test.
    IncompleteRecordError
        The recording was cut, or the test ended before a sample was recorded.

    """
    source = str(path)
    content = read_content(Path(path), _READ_TOPICS, validate_crcs=validate_crcs)
    found = read_test_metadata(content.metadata, source)
    if found.provenance.status != "complete" and not content.messages.get(SAMPLES):
        raise IncompleteRecordError(
            f"{source}: the test was {found.provenance.status} before a sample was recorded: "
            "record the test again"
        )
    _check_counts(content, found.counts, source)
    samples = _samples(content, source)
    check_samples(samples, source, values=validate_values)
    try:
        return _record(content, found, samples)
    except InvalidRecordError as error:
        raise InvalidRecordError(f"{source}: {error}") from None


def _check_counts(content: BagContent, counts: Mapping[str, int], source: str) -> None:
    """Compare the messages that were read with those that were written."""
    for topic in sorted(_READ_TOPICS & counts.keys()):
        read = len(content.messages.get(topic, []))
        if read != counts[topic]:
            raise InvalidRecordError(
                f"{source}: {read} messages on {topic}, its recorder wrote {counts[topic]}: the "
                "bag was edited or damaged; copy it again from where it was recorded"
            )


def _record(content: BagContent, found: TestMetadata, samples: np.ndarray) -> Record:
    """Join what was read; errors name the topic, not the bag."""
    profile, provenance = found.profile, found.provenance
    if profile is None:
        command = _command(content)
        profile = decode_command(
            command.data,
            start=float(samples[0, SURFACE_POSITION]),
            duration=float(samples[-1, TIME]),
        )
        provenance = replace(provenance, start_time=command.log_time)
    else:
        _check_command(content, profile, samples)
    start_time = provenance.start_time
    return Record(
        samples=samples,
        profile=profile,
        provenance=provenance,
        dc_bus=_slow(content, DC_BUS, BATTERY_STATE, start_time),
        winding_temperature=_slow(content, WINDING_TEMPERATURE, TEMPERATURE, start_time),
    )


def _samples(content: BagContent, source: str) -> np.ndarray:
    """Return all samples, shape (n, 10), in the order of their log times."""
    blocks = []
    count = 0
    for message in content.messages.get(SAMPLES, []):
        try:
            block = decode_block(message.data)
        except InvalidRecordError as error:
            raise InvalidRecordError(f"{source}: {error}") from None
        count += len(block)
        if count > MAX_SAMPLES:
            raise InvalidRecordError(f"{source}: more than {MAX_SAMPLES} samples: split the bag")
        blocks.append(block)
    if count == 0:
        if SAMPLES in content.topics:
            raise InvalidRecordError(
                f"{source}: no message on {SAMPLES}: nothing was measured; record the test again"
            )
        topics = ", ".join(sorted(content.topics))[:120] or "none"
        raise InvalidRecordError(
            f"{source}: no topic {SAMPLES} (its topics: {topics}): record the acquisition, or "
            "convert the file with 'ema import'"
        )
    return np.concatenate(blocks)


def check_samples(samples: np.ndarray, source: str, *, values: bool = True) -> None:
    """Check the bounds of samples and, with `values`, that they are finite and in time order.

    Raises
    ------
    InvalidRecordError
        The first sample that is wrong is named.

    """
    if values:
        finite = np.isfinite(samples)
        if not finite.all():
            row, column = np.argwhere(~finite)[0]
            raise InvalidRecordError(
                f"{source}: sample {row}, channel {column} is {samples[row, column]}: every "
                "value must be finite; look at the transducer or its cable"
            )
        steps = np.diff(samples[:, TIME])
        if len(steps) and steps.min() <= 0.0:
            row = int(np.argmax(steps <= 0.0)) + 1
            raise InvalidRecordError(
                f"{source}: time does not increase at sample {row}: {samples[row, TIME]:.9g} s "
                f"after {samples[row - 1, TIME]:.9g} s: blocks were lost, repeated or mixed"
            )
        if len(steps) and steps.min() < 0.5 / MAX_RATE:
            raise InvalidRecordError(
                f"{source}: interval of {steps.min():.3g} s between samples, at least "
                f"{1.0 / MAX_RATE:g} s: check the time channel"
            )
        if samples[-1, TIME] - samples[0, TIME] > MAX_DURATION + 1.0:
            raise InvalidRecordError(
                f"{source}: {samples[-1, TIME] - samples[0, TIME]:.3g} s long, at most "
                f"{MAX_DURATION:g} s: a record holds one test"
            )


def _command(content: BagContent) -> StoredMessage:
    """Return the command that was given last before the first samples."""
    commands = content.messages.get(COMMAND, [])
    if not commands:
        raise InvalidRecordError(
            f"neither test metadata nor a message on {COMMAND}: the test profile is not known; "
            f"record {COMMAND} too"
        )
    first = content.messages[SAMPLES][0].log_time
    before = [message for message in commands if message.log_time <= first]
    return (before or commands[:1])[-1]


def _check_command(content: BagContent, profile: Profile, samples: np.ndarray) -> None:
    """Compare the profile of the metadata with the command, where that was recorded."""
    if not content.messages.get(COMMAND):
        return
    commanded = decode_command(
        _command(content).data, start=profile.start, duration=float(samples[-1, TIME])
    )
    if trajectory_points(commanded) != trajectory_points(profile):
        raise InvalidRecordError(
            f"the metadata say that the test was {profile.name!r}, {COMMAND} is another profile "
            f"({commanded.name!r}): the bag was edited or mixed; record the test again"
        )


def _slow(
    content: BagContent, topic: str, message_type: str, start_time: int
) -> np.ndarray:
    """Return a slow topic, columns as in `Record`."""
    rows = []
    for message in content.messages.get(topic, []):
        decoded = deserialize(message.data, message_type, topic)
        time = (_time_of(message, decoded) - start_time) / NANOSECONDS
        values = bus_reading(decoded) if topic == DC_BUS else (float(decoded.temperature),)
        rows.append([time, *values])
    return np.array(rows, dtype=np.float64).reshape(len(rows), 3 if topic == DC_BUS else 2)


def _time_of(message: StoredMessage, decoded: Any) -> int:
    """Return the stamp of a message (ns), or its log time where it has none."""
    return stamp_of(decoded) or message.log_time


def write_bag(
    record: Record,
    path: str | Path,
    *,
    views: bool = True,
    chunk_size: int = CHUNK_SIZE,
) -> Path:
    """Write a record as a bag, the same bytes for the same record.

    Parameters
    ----------
    record : Record
        At least one sample.
    path : path-like
        The directory to make.
    views : bool
        Also write the topics for people, decimated to 2 kHz: joint states, phase currents.
    chunk_size : int
        See `BagWriter`.

    Returns
    -------
    Path
        The directory.

    Raises
    ------
    OutputError
        `path` exists, or cannot be written.
    UsageError
        No sample, or times before the acceptance of the command.

    """
    messages = _messages(record, views=views)
    with BagWriter(
        path, profile=record.profile, provenance=record.provenance,
        chunk_size=chunk_size, flush_interval=None,
    ) as writer:
        for time, topic, data in messages:
            writer.write_raw(topic, data, time)
        return writer.close(record.provenance.status)


def _messages(record: Record, *, views: bool) -> list[tuple[int, str, bytes]]:
    """Return all messages of a record as (log time (ns), topic, CDR), in order of time."""
    if len(record) == 0:
        raise UsageError("the record has no sample: there is nothing to write")
    start = record.provenance.start_time
    messages = [(start, WEIGHT_ON_WHEELS, encode_bool(True)),
                (start, COMMAND, encode_command(record.profile, start))]
    for first in range(0, len(record), BLOCK_SIZE):
        block = record.samples[first:first + BLOCK_SIZE]
        time = int(_stamps(block[-1:, TIME], start)[0])
        messages.append((time, SAMPLES, encode_block(block)))
    if views and len(record) > 1:
        decimated = views_of(record.samples, record.rate)
        stamps = decimated.stamps(start).tolist()
        messages += _on(JOINT_STATES, stamps, decimated.joint_states(start))
        messages += _on(PHASE_CURRENTS, stamps, decimated.phase_currents(start))
    bus, winding = record.dc_bus, record.winding_temperature
    stamps = _stamps(bus[:, 0], start)
    messages += _on(DC_BUS, stamps.tolist(), encode_dc_bus(stamps, bus[:, 1], bus[:, 2]))
    stamps = _stamps(winding[:, 0], start)
    messages += _on(
        WINDING_TEMPERATURE, stamps.tolist(), encode_temperature(stamps, winding[:, 1])
    )
    return sorted(messages, key=lambda message: message[0])


def _on(topic: str, stamps: list[int], data: list[bytes]) -> list[tuple[int, str, bytes]]:
    return [(stamp, topic, message) for stamp, message in zip(stamps, data)]


def _stamps(time: np.ndarray, start: int) -> np.ndarray:
    """Return times since the acceptance (s) as stamps (ns since the epoch)."""
    if len(time) and not (np.isfinite(time).all() and time.min() >= 0.0):
        raise UsageError(
            "the record has times that are negative or not finite: times count from the "
            "acceptance of the command"
        )
    return start + np.rint(time * NANOSECONDS).astype(np.int64)
