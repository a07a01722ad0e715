"""Bags as no recorder of ours writes them: of messages that were changed, of another library."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mcap.writer
import numpy as np

from ema_record.bag.container import read_content
from ema_record.bag.read import write_bag
from ema_record.bag.writer import BagWriter
from ema_record.profile import Profile
from ema_record.record import Provenance, Record, Status
from ema_record.wire.samples import decode_block, encode_block
from ema_record.wire.topics import BAG_TOPICS, SAMPLES, TOPICS
from ema_record.wire.types import definition


def write_mcap(
    path: Path, messages: Iterable[tuple[str, int, bytes]], *, encoding: str = "cdr",
    types: Mapping[str, str] | None = None, metadata: Mapping[str, dict[str, str]] | None = None,
    **options: Any,
) -> Path:
    """Write one plain .mcap file with the writer of the mcap library.

    Parameters
    ----------
    messages : topic, log time (ns), CDR.
    encoding : of the messages, as the file says.
    types : of topics, where they are not those of the table.
    metadata : records by name, before the messages.
    options : of the writer.
    """
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream, **options)
        writer.start(profile="ros2", library="another recorder")
        for name, values in (metadata or {}).items():
            writer.add_metadata(name, values)
        channels: dict[str, int] = {}
        for topic, time, data in messages:
            if topic not in channels:
                kind = (types or {}).get(topic) or TOPICS[topic].type
                schema = writer.register_schema(kind, "ros2msg", definition(kind).encode())
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], time, data, time)
        writer.finish()
    return path


@dataclass
class Recording:
    """The messages of a bag that is about to be written."""

    record: Record
    blocks: list[tuple[int, np.ndarray]]
    """Log time (ns) and samples."""
    others: list[tuple[int, str, bytes]]
    """Log time (ns), topic, message."""
    profile: Profile
    provenance: Provenance
    status: Status = "complete"

    @classmethod
    def of(cls, record: Record, folder: Path) -> Recording:
        """Return the messages that `write_bag` writes of a record."""
        content = read_content(
            write_bag(record, folder, views=False), frozenset(t.name for t in BAG_TOPICS)
        )
        return cls(
            record=record,
            blocks=[(m.log_time, decode_block(m.data).copy()) for m in content.messages[SAMPLES]],
            others=[(m.log_time, topic, bytes(m.data))
                    for topic, messages in content.messages.items() if topic != SAMPLES
                    for m in messages],
            profile=record.profile, provenance=record.provenance,
        )

    def change(self, law: Callable[[np.ndarray], None]) -> None:
        """Change all samples, shape (n, 10), in place."""
        samples = np.concatenate([block for _, block in self.blocks])
        law(samples)
        first = 0
        for number, (time, block) in enumerate(self.blocks):
            self.blocks[number] = time, samples[first:first + len(block)]
            first += len(block)

    def write(self, path: Path) -> Path:
        """Write the bag in the order in which the messages stand."""
        queue = sorted(self.others, key=lambda m: m[0])
        with BagWriter(
            path, profile=self.profile, provenance=self.provenance, flush_interval=None
        ) as writer:
            for time, block in self.blocks:
                while queue and queue[0][0] <= time:
                    stamp, topic, data = queue.pop(0)
                    writer.write_raw(topic, data, stamp)
                writer.write_raw(SAMPLES, encode_block(block), time)
            for stamp, topic, data in queue:
                writer.write_raw(topic, data, stamp)
            return writer.close(self.status)
