"""The recorder of the built-in test: one bag, its clock, and the samples for the record checks."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from ema_record.actuator_type import actuator_hash
from ema_record.bag.writer import BagWriter
from ema_record.channels import N_CHANNELS, SURFACE_POSITION, TIME
from ema_record.profile import Profile
from ema_record.record import Provenance, Record, Status
from ema_record.version import VERSION
from ema_record.wire.samples import decode_block
from ema_record.wire.topics import BAG_TOPICS, SAMPLES
from ema_record.wire.types import NANOSECONDS

_IN_BAG = frozenset(topic.name for topic in BAG_TOPICS)


def new_bag_path(
    directory: Path, serial_number: str, stamp: int, profile: str, name: str = ""
) -> Path:
    """Return a name that is not taken: ``<serial>_<UTC time>_<profile>``.

    The name of the actuator stands before it, where there are several: ``left_aileron_``.
    """
    begin = datetime.fromtimestamp(stamp / 1e9, tz=timezone.utc).strftime("%Y%m%dT%H%M%SZ")
    serial = re.sub(r"[^A-Za-z0-9.-]+", "-", serial_number).strip("-.")[:40] or "unknown"
    prefix = name.replace("/", "_") + "_" if name else ""
    stem = f"{prefix}{serial}_{begin}_{profile}"
    path, number = Path(os.path.expanduser(directory)) / stem, 1  # noqa: PTH111  (never raises)
    while path.exists():
        number += 1
        path = path.with_name(f"{stem}_{number}")
    return path


class LogClock:
    """Reception times that a step of the host's clock does not put out of order.

    Parameters
    ----------
    wall : clock of the host (ns since the epoch).
    steady : monotonic clock (s).
    """

    def __init__(
        self, wall: Callable[[], int] = time.time_ns, steady: Callable[[], float] = time.monotonic
    ) -> None:
        self._wall, self._steady = wall, steady
        self._begin, self._origin = wall(), steady()
        self._last: dict[str, int] = {}
        self._now, self._shift = self._begin, 0

    def look(self) -> None:
        """Compare the clocks; to be called before messages are taken."""
        self._now = self._begin + round((self._steady() - self._origin) * NANOSECONDS)
        self._shift = self._wall() - self._now

    @property
    def shift(self) -> float:
        """By how much the host's clock has stepped since the begin (s)."""
        return self._shift / NANOSECONDS

    def log_time(self, topic: str, received: int) -> int:
        """Return when a message of `topic` came (ns), never before the one before it.

        Parameters
        ----------
        topic : its topic.
        received : by the host's clock (ns since the epoch).
        """
        steady = min(received - self._shift, self._now)
        self._last[topic] = max(steady, self._last.get(topic, 0))
        return self._last[topic]


class BitRecorder:
    """Counts what arrives; while a bag is open, writes it and keeps its samples."""

    def __init__(self, namespace: str = "") -> None:
        """Begin without a bag; `namespace` is the actuator's."""
        self._namespace = namespace
        self._writer: BagWriter | None = None
        self._blocks: list[np.ndarray] = []
        self.clock = LogClock()
        """Since the bag was opened."""
        self.samples_received = 0
        """Since `reset_count`."""
        self.last_sample = -1.0
        """Time of the last sample since `reset_count` (s)."""
        self.last_position: float | None = None
        """Of the surface in that sample (rad); None: not recorded."""
        self.samples_recorded = 0
        """In the bag."""

    def reset_count(self) -> None:
        """Count samples from here on: a command was sent."""
        self.samples_received, self.last_sample, self.last_position = 0, -1.0, None

    def open(self, path: Path, profile: Profile, serial_number: str, stamp: int) -> None:
        """Make the bag, which names the kit's actuator (OutputError: it cannot be made)."""
        self._writer = BagWriter(
            path, profile=profile,
            provenance=Provenance(
                serial_number=serial_number, software_version=VERSION, start_time=stamp,
                actuator=actuator_hash(), namespace=self._namespace,
            ),
        )
        self._blocks = []
        self.clock = LogClock()
        self.samples_recorded = 0

    def take(self, topic: str, data: bytes, received: int, publish_time: int) -> None:
        """Take one serialised message.

        Raises
        ------
        InvalidRecordError
            A block of samples is damaged; it was written all the same.
        OutputError
            The bag cannot be written.
        """
        if self._writer is not None and topic in _IN_BAG:
            self._writer.write_raw(
                topic, data, self.clock.log_time(topic, received), publish_time
            )
        if topic != SAMPLES:
            return
        block = decode_block(data)
        if len(block) == 0:
            return
        self.samples_received += len(block)
        self.last_sample = float(block[-1, TIME])
        position = float(block[-1, SURFACE_POSITION])
        self.last_position = position if math.isfinite(position) else None
        if self._writer is not None:
            self.samples_recorded += len(block)
            self._blocks.append(block)

    def close(self, status: Status, start_time: int | None) -> Path | None:
        """Finish the bag and return its path, None if none was open."""
        writer, self._writer = self._writer, None
        return writer.close(status, start_time=start_time) if writer is not None else None

    def record(self, profile: Profile) -> Record:
        """Return what was recorded, for the record checks."""
        samples = np.concatenate(self._blocks) if self._blocks else np.empty((0, N_CHANNELS))
        return Record(samples=samples, profile=profile)
