"""The messages of a bag in the order and the time in which they are to be replayed."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from ema_record.actuator_type import another_actuator, is_of_another_actuator
from ema_record.bag.container import read_content
from ema_record.bag.read import read_bag
from ema_record.errors import IncompleteRecordError, InvalidRecordError, UsageError
from ema_record.record import Record
from ema_record.wire.topics import BAG_TOPICS, COMMAND, SAMPLES, WEIGHT_ON_WHEELS
from ema_record.wire.trajectory import encode_command
from ema_record.wire.types import NANOSECONDS

MAX_LENGTH = 3600.0
"""Longest span of the log times of a bag that is replayed (s)."""
ANYWAY = "give --anyway to publish it all the same"


class ReplayMessage(NamedTuple):
    """One message and when it is due."""

    time: float
    """Since the first message (s)."""
    topic: str
    data: bytes


def load_messages(path: Path, *, anyway: bool = False) -> list[ReplayMessage]:
    """Return the messages of a record, ordered by log time, the command before the samples.

    Weight on wheels is left out: what a replay says must not open an interlock.

    Parameters
    ----------
    path : of the bag.
    anyway : also of a record that is not complete or of another actuator than the kit's. The
        topics do not say so: who listens would judge it as a whole one of this actuator.

    Raises
    ------
    InvalidRecordError, IncompleteRecordError
        The bag is not a readable record, or not complete.
    UsageError
        It is of another actuator.
    """
    record = read_bag(path, validate_values=False)
    if not anyway:
        _check_said(record, path)
    topics = [topic.name for topic in BAG_TOPICS if topic.name != WEIGHT_ON_WHEELS]
    content = read_content(path, frozenset(topics))
    found = [
        (message.log_time, topic, bytes(message.data))
        for topic in topics
        for message in content.messages.get(topic, [])
    ]
    first_samples = min(time for time, topic, _ in found if topic == SAMPLES)
    if not any(topic == COMMAND and time <= first_samples for time, topic, _ in found):
        command = encode_command(record.profile, record.provenance.start_time)
        found.append((first_samples, COMMAND, command))
    found.sort(key=lambda item: (item[0], item[1] == SAMPLES))
    begin = found[0][0]
    last = (found[-1][0] - begin) / NANOSECONDS
    if last > MAX_LENGTH:
        raise InvalidRecordError(
            f"{path}: its messages span {last:.0f} s, at most {MAX_LENGTH:g} s: "
            "a record holds one test"
        )
    return [ReplayMessage((time - begin) / NANOSECONDS, topic, data)
            for time, topic, data in found]


def _check_said(record: Record, path: Path) -> None:
    """Raise where the topics lack what forbids a verdict on a record."""
    of = record.provenance
    unsaid = f"the topics do not say so; judge it by 'ema check', or {ANYWAY}"
    if of.status != "complete":
        raise IncompleteRecordError(f"{path}: the record is {of.status}, not complete: {unsaid}")
    if is_of_another_actuator(of.actuator):
        raise UsageError(f"{path}: {another_actuator(of.actuator)}: {unsaid}")
