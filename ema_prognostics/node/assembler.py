"""`RecordAssembler`: a record from the live topics, where no recorder is at work."""

from __future__ import annotations

from collections import deque

import numpy as np

from ema_record.channels import SURFACE_POSITION, TIME
from ema_record.errors import IncompleteRecordError, InvalidRecordError
from ema_record.limits import MAX_SAMPLES
from ema_record.profile import Profile
from ema_record.record import Provenance, Record
from ema_record.wire.samples import decode_block
from ema_record.wire.sensors import BATTERY_STATE, TEMPERATURE, bus_reading
from ema_record.wire.topics import COMMAND, DC_BUS, SAMPLES, WINDING_TEMPERATURE
from ema_record.wire.trajectory import JOINT_TRAJECTORY, decode_command
from ema_record.wire.types import NANOSECONDS, deserialize, stamp_of

TOPICS = (COMMAND, SAMPLES, DC_BUS, WINDING_TEMPERATURE)
SILENCE = 2.0
"""Pause of the samples after which the record is taken as it is (s)."""
MAX_SLOW = 10_000
"""Most readings of bus and temperature that are kept, the latest ones."""
BEFORE = 2.0
"""Readings of bus and temperature from so long before the command belong to it (s)."""


class RecordAssembler:
    """Joins one command and the samples that answer it.

    A record is finished when its samples cover the command, or when they stop. The order
    in which the topics arrive does not matter; time that runs back begins another run.
    """

    def __init__(self) -> None:
        self._clear()

    def _clear(self) -> None:
        self._command: bytes | None = None
        self._blocks: list[np.ndarray] = []
        self._count = 0
        self._ahead = False  # blocks of the next test, whose command is still to come
        self._last_block = 0.0
        self._bus: deque[tuple[int, float, float]] = deque(maxlen=MAX_SLOW)
        self._temperature: deque[tuple[int, float]] = deque(maxlen=MAX_SLOW)

    def take(self, topic: str, data: bytes, now: float) -> None:
        """Take one serialised message at clock `now` (s).

        Raises
        ------
        InvalidRecordError
            The message is damaged, came twice, or the samples never end.
        """
        if topic == COMMAND:
            if self._command is not None and not self._ahead:
                self._clear()
            self._command, self._ahead = data, False
        elif topic == SAMPLES:
            self._take_block(decode_block(data), now)
        elif topic == DC_BUS:
            message = deserialize(data, BATTERY_STATE, topic)
            self._bus.append((stamp_of(message), *bus_reading(message)))
        elif topic == WINDING_TEMPERATURE:
            message = deserialize(data, TEMPERATURE, topic)
            self._temperature.append((stamp_of(message), float(message.temperature)))

    def _take_block(self, block: np.ndarray, now: float) -> None:
        if len(block) == 0:
            return
        if self._blocks and np.array_equal(block, self._blocks[-1], equal_nan=True):
            raise InvalidRecordError(f"{SAMPLES}: a message came twice and is left out: look for "
                                     "a second publisher")
        if self._blocks and block[0, TIME] <= self._blocks[-1][-1, TIME]:
            self._blocks, self._count, self._ahead = [], 0, True
        self._count += len(block)
        if self._count > MAX_SAMPLES:
            self._clear()
            raise InvalidRecordError(f"{SAMPLES}: more than {MAX_SAMPLES} samples for one command")
        self._blocks.append(block)
        self._last_block = now

    def finished(self, now: float) -> Record | None:
        """Return the record if it is finished at clock `now` (s), and begin the next one.

        Raises
        ------
        InvalidRecordError
            The command is damaged or out of bounds.
        IncompleteRecordError
            The samples stopped, and no command came with them.
        """
        if not self._blocks:
            return None
        silent = now - self._last_block > SILENCE
        if self._command is None:
            if not silent:
                return None
            count = self._count
            self._clear()
            raise IncompleteRecordError(
                f"{SAMPLES}: {count} samples without their command on {COMMAND}, so no verdict: "
                "the prognostics must be up before the test or the replay begins"
            )
        try:
            profile = self._profile(silent)
        except InvalidRecordError:
            self._clear()
            raise
        if profile is None:
            return None
        record = self._record(profile)
        self._clear()
        return record

    def _profile(self, silent: bool) -> Profile | None:
        """Return the profile of the command if the samples cover it or have stopped."""
        assert self._command is not None
        message = deserialize(self._command, JOINT_TRAJECTORY, COMMAND)
        last = float(self._blocks[-1][-1, TIME])
        if len(message.points) < 2 and not silent:
            return None
        at = float(self._blocks[0][0, SURFACE_POSITION])
        profile = decode_command(
            self._command, start=at if np.isfinite(at) else None, duration=last
        )
        times = self._blocks[-1][:, TIME]
        interval = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        return profile if silent or last + interval >= profile.duration else None

    def _record(self, profile: Profile) -> Record:
        assert self._command is not None
        start = stamp_of(deserialize(self._command, JOINT_TRAJECTORY, COMMAND))
        since = start - round(BEFORE * NANOSECONDS)
        bus = [((stamp - start) / NANOSECONDS, *values)
               for stamp, *values in self._bus if stamp >= since]
        temperature = [((stamp - start) / NANOSECONDS, value)
                       for stamp, value in self._temperature if stamp >= since]
        return Record(
            samples=np.concatenate(self._blocks),
            profile=profile,
            provenance=Provenance(start_time=start),
            dc_bus=np.array(bus, dtype=np.float64).reshape(len(bus), 3),
            winding_temperature=np.array(temperature, dtype=np.float64).reshape(
                len(temperature), 2),
        )
