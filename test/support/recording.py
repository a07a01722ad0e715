"""The messages of a bag, to be changed before they are written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ema_record.bag.container import read_content
from ema_record.bag.read import write_bag
from ema_record.bag.writer import BagWriter
from ema_record.profile import Profile
from ema_record.record import Provenance, Record, Status
from ema_record.wire.samples import decode_block, encode_block
from ema_record.wire.topics import BAG_TOPICS, SAMPLES


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
