"""The clock of a record: that of the host at its begin, and steady from there on."""

from __future__ import annotations

import time
from collections.abc import Callable

from ema_record.wire.types import NANOSECONDS


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
        """Begin with the time of the host."""
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
