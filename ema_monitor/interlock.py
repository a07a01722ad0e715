"""The interlock: the actuator moves only while the aircraft stands on its wheels."""

from __future__ import annotations

DEFAULT_TIMEOUT = 1.0
"""Age at which weight on wheels is no longer fresh (s); the aircraft sends ten a second."""


class Interlock:
    """Weight on wheels, and whether it is fresh.

    Parameters
    ----------
    timeout : age at which the last message is stale (s).
    """

    def __init__(self, timeout: float = DEFAULT_TIMEOUT) -> None:
        """Begin without any message: refused."""
        self.timeout = timeout
        self._value = False
        self._received: float | None = None
        self._transit = 0.0

    def update(self, value: bool, now: float, transit: float = 0.0) -> None:
        """Take one message.

        Parameters
        ----------
        value : weight on wheels.
        now : monotonic clock (s).
        transit : age of the message when it arrived (s). A late joiner is handed the last
            message of the aircraft, however old: it counts from when it was sent.
        """
        self._value, self._received, self._transit = value, now, max(0.0, transit)

    def reason(self, now: float) -> str:
        """Return why the actuator must not move at clock `now` (s); empty: it may."""
        if self._received is None:
            return "no weight-on-wheels signal from the aircraft"
        age = now - self._received + self._transit
        if age > self.timeout:
            return f"weight-on-wheels signal is {age:.1f} s old, at most {self.timeout:g} s"
        if not self._value:
            return "no weight on wheels: the aircraft is not on the ground"
        return ""
