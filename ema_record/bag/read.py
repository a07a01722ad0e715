"""`read_bag` and `write_bag`: a `Record` from and to a rosbag2 directory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ema_record.bag.container import StoredMessage, read_content
from ema_record.bag.metadata import read_test_metadata
from ema_record.channels import SURFACE_POSITION, TIME
from ema_record.errors import IncompleteRecordError, InvalidRecordError, RecordError, UsageError
from ema_record.limits import MAX_DURATION, MAX_SAMPLES
from ema_record.profile import Profile
from ema_record.record import Record, SampleBlock, check_samples
from ema_record.wire.samples import BLOCK_SIZE, decode_block, encode_samples
from ema_record.wire.sensors import bus_reading, encode_bool, encode_dc_bus, encode_temperature
from ema_record.wire.topics import (
    COMMAND,
    DC_BUS,
    JOINT_STATES,
    PHASE_CURRENTS,
    SAMPLES,
    TOPICS,
    WEIGHT_ON_WHEELS,
    WINDING_TEMPERATURE,
)
from ema_record.wire.trajectory import decode_command, encode_command, trajectory_points
from ema_record.wire.types import NANOSECONDS, deserialize, is_stamp, stamp_of
from ema_record.wire.views import ViewDecimator

_READ_TOPICS = frozenset({SAMPLES, COMMAND, DC_BUS, WINDING_TEMPERATURE})


def read_bag(path: str | Path, *, validate_values: bool = True) -> Record:
    """Return the record that a bag holds.

    Parameters
    ----------
    path : a rosbag2 directory of any conforming recorder, or a single ``.mcap`` file.
    validate_values : refuse samples that are not finite or whose time does not increase. Without
        it they are left to the caller, as the record checks of the built-in test do.

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
    bag = Recording(path)
    bag.check_counts()
    blocks = bag.blocks()
    if not blocks:
        raise bag.without_samples()
    samples = np.asfortranarray(np.concatenate([block.samples for block in blocks]))
    if validate_values:
        check_samples(samples, bag.source)
    profile, provenance = bag.test.profile, bag.test.provenance
    commanded = bag.command(
        blocks, start=None if profile is None else profile.start, likely=profile)
    if profile is None:
        if commanded is None:
            raise InvalidRecordError(
                f"{bag.source}: neither test metadata nor a message on {COMMAND}: the test "
                f"profile is not known; record {COMMAND} too"
            )
        profile = commanded
        provenance = replace(provenance, start_time=bag.command_before(blocks)[0].log_time)
    elif commanded is not None and trajectory_points(commanded) != trajectory_points(profile):
        raise InvalidRecordError(
            f"{bag.source}: the metadata say that the test was {profile.name!r}, {COMMAND} is "
            f"another profile ({commanded.name!r}): the bag was edited or mixed; record the test "
            "again"
        )
    return Record(
        samples=samples, profile=profile, provenance=provenance,
        dc_bus=bag.slow(DC_BUS, provenance.start_time),
        winding_temperature=bag.slow(WINDING_TEMPERATURE, provenance.start_time),
    )


class Recording:
    """A bag of a test, its topics decoded one by one.

    Parameters
    ----------
    path : see `read_bag`.
    topics : what else is read.
    as_recorded : leave messages in the order of the file, and note those that cannot be decoded
        in `errors` instead of refusing the bag.

    Attributes
    ----------
    content : messages and metadata as they are.
    test : our own metadata, as far as the bag has them.
    errors : messages that cannot be decoded, one line each; empty where they are refused.
    """

    def __init__(
        self, path: str | Path, topics: Sequence[str] = (), *, as_recorded: bool = False
    ) -> None:
        """Read the messages (InvalidRecordError, IncompleteRecordError: they cannot be)."""
        self.source = str(path)
        self.content = read_content(
            Path(path), _READ_TOPICS.union(topics), file_order=as_recorded)
        test = read_test_metadata(self.content.metadata, self.source)
        self.test = replace(
            test, provenance=replace(test.provenance, namespace=self.content.namespace)
        )
        self.errors: list[str] = []
        self._as_recorded = as_recorded

    def _refuse(self, error: RecordError) -> None:
        if not self._as_recorded:
            raise InvalidRecordError(f"{self.source}: {error}") from None
        self.errors.append(str(error))

    def check_counts(self) -> None:
        """Compare the messages that were read with those that were written."""
        if self.test.provenance.status != "complete" and not self.content.messages.get(SAMPLES):
            raise IncompleteRecordError(
                f"{self.source}: the test was {self.test.provenance.status} before a sample was "
                "recorded: record the test again"
            )
        counts = self.test.counts
        for topic in sorted(_READ_TOPICS & counts.keys()):
            read = len(self.content.messages.get(topic, []))
            if read != counts[topic]:
                raise InvalidRecordError(
                    f"{self.source}: {read} messages on {topic}, its recorder wrote "
                    f"{counts[topic]}: the bag was edited or damaged; copy it again from where "
                    "it was recorded"
                )

    def blocks(self) -> list[SampleBlock]:
        """Return the messages of samples that hold any."""
        blocks: list[SampleBlock] = []
        count = 0
        for message in self.content.messages.get(SAMPLES, []):
            try:
                samples = decode_block(message.data)
            except InvalidRecordError as error:
                self._refuse(error)
                continue
            count += len(samples)
            if count > MAX_SAMPLES:
                raise InvalidRecordError(
                    f"{self.source}: more than {MAX_SAMPLES} samples: split the bag"
                )
            if len(samples):
                blocks.append(SampleBlock(message.log_time, samples))
        return blocks

    def without_samples(self) -> InvalidRecordError:
        """Return the error for a bag without a sample."""
        if SAMPLES in self.content.topics:
            return InvalidRecordError(
                f"{self.source}: no message on {SAMPLES}: nothing was measured; record the test "
                "again"
            )
        topics = ", ".join(sorted(self.content.topics))[:120] or "none"
        return InvalidRecordError(
            f"{self.source}: no topic {SAMPLES} (its topics: {topics}): record the acquisition, "
            "or convert the file with 'ema import'"
        )

    def command_before(self, blocks: Sequence[SampleBlock]) -> list[StoredMessage]:
        """Return the command that was given last before the first samples; empty: none was."""
        commands = self.content.messages.get(COMMAND, [])
        before = [m for m in commands if m.log_time <= blocks[0].log_time]
        return (before or commands[:1])[-1:]

    def command(
        self, blocks: Sequence[SampleBlock], start: float | None = None,
        likely: Profile | None = None,
    ) -> Profile | None:
        """Return the profile of that command; None: there is none.

        Parameters
        ----------
        blocks : at least one.
        start : where the surface stood before (rad), default as the first sample says, if it does.
        likely : what it probably is.
        """
        for message in self.command_before(blocks):
            first, last = blocks[0].samples[0], blocks[-1].samples[-1]
            at = float(first[SURFACE_POSITION])
            if start is None and np.isfinite(at):
                start = at
            try:
                return decode_command(message.data, duration=float(last[TIME]), start=start,
                                      likely=likely)
            except RecordError as error:
                self._refuse(error)
        return None

    def decoded(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield log time (ns since the epoch) and content of a topic's messages."""
        for message in self.content.messages.get(topic, []):
            try:
                yield message.log_time, deserialize(message.data, TOPICS[topic].type, topic)
            except RecordError as error:
                self._refuse(error)

    def slow(self, topic: str, start_time: int = 0) -> np.ndarray:
        """Return `/ema/dc_bus` or `/ema/winding_temperature`, columns as in `Record`."""
        rows = []
        for log_time, said in self.decoded(topic):
            time = ((stamp_of(said) or log_time) - start_time) / NANOSECONDS
            values = bus_reading(said) if topic == DC_BUS else (float(said.temperature),)
            rows.append([time, *values])
        return np.array(rows, dtype=np.float64).reshape(len(rows), 3 if topic == DC_BUS else 2)


def write_bag(record: Record, path: str | Path, *, views: bool = True) -> Path:
    """Write a record as a bag, the same bytes for the same record.

    Parameters
    ----------
    record : at least one sample; channels that are NaN throughout are left out.
    path : the directory to make, which is returned.
    views : also write the topics for people, decimated: joint states, phase currents.

    Raises
    ------
    OutputError
        `path` exists, or cannot be written.
    UsageError
        No sample, times that do not increase or are before the acceptance of the command, or a
        date that no message holds.
    """
    from ema_record.bag.writer import BagWriter

    begin = record.provenance.start_time
    if not (is_stamp(begin) and is_stamp(begin + round(MAX_DURATION * NANOSECONDS))):
        raise UsageError(f"start time {begin} ns: give nanoseconds since 1970, until 2038")
    messages = _messages(record, views=views)
    with BagWriter(path, profile=record.profile, provenance=record.provenance,
                   flush_interval=None) as writer, writer.whole():
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
    columns = record.columns
    for first in range(0, len(record), BLOCK_SIZE):
        block = record.samples[first:first + BLOCK_SIZE]
        time = int(_stamps(block[-1:, TIME], start)[0])
        messages.append((time, SAMPLES, encode_samples(block, columns)))
    if views and len(record) > 1:
        if not np.median(np.diff(record.time)) > 0.0:
            raise UsageError("the record's times do not increase: check the time channel")
        decimated = ViewDecimator(record.rate).push(record.samples)
        stamps = decimated.stamps(start).tolist()
        messages += _on(JOINT_STATES, stamps, decimated.joint_states(start))
        messages += _on(PHASE_CURRENTS, stamps, decimated.phase_currents(start))
    bus, winding = record.dc_bus, record.winding_temperature
    earliest = -start / NANOSECONDS  # what a live test had read before the command counts too
    stamps = _stamps(bus[:, 0], start, earliest)
    messages += _on(DC_BUS, stamps.tolist(), encode_dc_bus(stamps, bus[:, 1], bus[:, 2]))
    stamps = _stamps(winding[:, 0], start, earliest)
    messages += _on(
        WINDING_TEMPERATURE, stamps.tolist(), encode_temperature(stamps, winding[:, 1])
    )
    return sorted(messages, key=lambda message: message[0])


def _on(topic: str, stamps: list[int], data: list[bytes]) -> list[tuple[int, str, bytes]]:
    return [(stamp, topic, message) for stamp, message in zip(stamps, data)]


def _stamps(time: np.ndarray, start: int, earliest: float = 0.0) -> np.ndarray:
    """Return times since the acceptance (s) as stamps (ns since the epoch)."""
    if len(time) and not (np.isfinite(time).all() and time.min() >= earliest):
        raise UsageError(
            "the record has times that are negative or not finite: times count from the "
            "acceptance of the command"
        )
    return start + np.rint(time * NANOSECONDS).astype(np.int64)
