"""The messages of a bag in the order and the time in which they are to be replayed."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from ema_record.bag.container import read_content
from ema_record.bag.read import read_bag
from ema_record.errors import InvalidRecordError
from ema_record.wire.topics import BAG_TOPICS, COMMAND, SAMPLES, WEIGHT_ON_WHEELS
from ema_record.wire.trajectory import encode_command
from ema_record.wire.types import NANOSECONDS

MAX_LENGTH = 3600.0
"""Longest span of the log times of a bag that is replayed (s)."""


class ReplayMessage(NamedTuple):
    """One message and when it is due."""

    time: float
    """Since the first message (s)."""
    topic: str
    data: bytes


def load_messages(path: Path) -> list[ReplayMessage]:
    """Return the messages of a record, ordered by log time, the command before the samples.

    Weight on wheels is left out: what a replay says must not open an interlock.

    Raises
    ------
    InvalidRecordError, IncompleteRecordError
        The bag is not a readable record.
    """
    record = read_bag(path, validate_values=False)
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
