"""The interlock: the actuator moves only while the aircraft stands on its wheels."""

from __future__ import annotations

DEFAULT_TIMEOUT = 1.0
"""Age at which weight on wheels is no longer fresh (s); the aircraft sends ten a second."""
HOLD = 1.25
"""For how many times `timeout` weight on wheels must be steady after it was off before it counts.

More than one: a source that says as rarely as it may that it is off is not overruled by another.
"""


class Interlock:
    """Weight on wheels, and whether it is fresh and steady.

    Parameters
    ----------
    timeout : age at which the last message is stale (s).
    hold : for how many times `timeout` it must be steady after it was off.
    """

    def __init__(self, timeout: float = DEFAULT_TIMEOUT, hold: float = HOLD) -> None:
        """Begin without any message: refused."""
        self.timeout, self.hold = timeout, hold * timeout
        self._value = False
        self._received: float | None = None
        self._transit = 0.0
        self._opened: float | None = None

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
        if not value:
            self._opened = now

    def is_undecided(self, now: float, asked: float) -> bool:
        """Whether a test asked for at clock `asked` (s) should wait for the first message.

        The request may overtake it: the middleware matches each topic on its own.
        """
        return self._received is None and now - asked <= self.timeout

    def reason(self, now: float, since: float | None = None) -> str:
        """Return why the actuator must not move at clock `now` (s); empty: it may.

        Parameters
        ----------
        now : monotonic clock (s).
        since : begin of the test that runs (s): the interlock must not have opened after it,
            however shortly. None: no test runs.
        """
        if self._received is None:
            return "no weight-on-wheels signal from the aircraft"
        age = now - self._received + self._transit
        if age > self.timeout:
            clocks = " (do the clocks agree?)" if self._transit > self.timeout else ""
            return (
                f"weight-on-wheels signal is {age:.1f} s old, at most {self.timeout:g} s{clocks}"
            )
        if not self._value:
            return "no weight on wheels: the aircraft is not on the ground"
        if self._opened is None:
            return ""
        steady = now - self._opened
        if since is not None and self._opened >= since:
            return f"weight on wheels went off for a moment, {steady:.2f} s ago"
        if steady < self.hold:
            return f"weight on wheels is back for {steady:.2f} s only, at least {self.hold:g} s"
        return ""


class Deadman:
    """The sign of life of who commands: it repeats the stamp of the command that it watches.

    Who never sends one is not asked for it. Signs for other commands neither keep the one that
    runs alive nor take the watch off it.

    Parameters
    ----------
    timeout : silence after which a command that was watched is given up (s).
    """

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self._running: int | None = None
        self._heard: float | None = None
        self._last: tuple[int | None, float] = None, 0.0

    def update(self, stamp: int, now: float) -> None:
        """Take a sign for the command with this stamp (ns) at clock `now` (s)."""
        self._last = stamp, now  # of a command, perhaps, that is still to come
        if stamp == self._running:
            self._heard = now

    def reason(self, stamp: int, now: float) -> str:
        """Return why the command with this stamp, which runs, must not go on; empty: it may."""
        if stamp != self._running:
            self._running = stamp
            self._heard = self._last[1] if self._last[0] == stamp else None
        silent = 0.0 if self._heard is None else now - self._heard
        if silent <= self.timeout:
            return ""
        return f"no sign of life from who commands for {silent:.2f} s"
