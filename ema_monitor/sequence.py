"""The sequence of the built-in test as a state machine: observations in, actions out.

Stages::

    IDLE -> FINDING -> POSITIONING -> TESTING -> COUNTING -> IDLE      the test
               |            |            |
               v            v            v
             IDLE   RETURNING, STOPPING <+                            refused, aborted

The record is open in TESTING and COUNTING. STOPPING is where the interlock has opened or somebody
has asked for the end: the surface is stopped where it is, and stays there until the next test.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from ema_monitor.moves import ramp, step_to
from ema_monitor.observation import ACTUATOR_TIMEOUT, Observation
from ema_record.actuator import Actuator
from ema_record.profile import Profile
from ema_record.record import Status

AT_START = 0.005
"""Distance from the profile's start at which no move is needed (of the way to the end stop)."""
FIND_TIMEOUT = 10.0
"""Longest search for an idle actuator (s)."""
COUNT_TIMEOUT = 5.0
"""Longest wait for the counters after the last sample (s)."""
END_MARGIN = (2e-3, 2.0)
"""By how much the last sample may come before the end of the profile: in s, and at least in
samples."""
RETURN_TIMEOUT = 5.0
"""Longest wait for the surface to be back after an abort, beyond its way from stop to stop (s)."""
STOP_TIMEOUT = 2.0
"""Longest wait for the surface to be at rest after a stop (s)."""
MOVE_SPEED = 0.5
"""Of a move (of the slew speed)."""


class Stage(enum.Enum):
    """Where the test is."""

    IDLE = "idle"
    FINDING = "looking for the actuator"
    POSITIONING = "moving to the start"
    TESTING = "recording"
    COUNTING = "counting samples"
    RETURNING = "bringing the surface back"
    STOPPING = "stopping the surface"


ENDING = Stage.IDLE, Stage.RETURNING, Stage.STOPPING
"""Where samples are not waited for, and a damaged one changes nothing."""


@dataclass(frozen=True, slots=True)
class SendCommand:
    """Publish a command."""

    profile: Profile
    stamp: int


@dataclass(frozen=True, slots=True)
class OpenRecord:
    """Begin the record."""

    profile: Profile
    stamp: int


@dataclass(frozen=True, slots=True)
class CloseRecord:
    """End the record."""

    status: Status
    start_time: int | None
    samples_published: int | None


@dataclass(frozen=True, slots=True)
class Finish:
    """Answer who asked for the test; empty reason: it ran to its end."""

    reason: str


Action = SendCommand | OpenRecord | CloseRecord | Finish


class TestSequence:
    """One built-in test after the other.

    Parameters
    ----------
    profile : the test; UsageError where it goes beyond the end stops.
    actuator : its travel, slew speed and rate of samples.
    stream_timeout : longest silence of the acquisition while it should send (s).
    test_timeout : longest test, positioning included (s).
    """

    __test__ = False

    def __init__(
        self, profile: Profile, actuator: Actuator, *, stream_timeout: float = 5.0,
        test_timeout: float = 120.0,
    ) -> None:
        self._end_stop = actuator.surface.end_stop
        profile.check_within(self._end_stop)
        self.profile = profile
        self._near = AT_START * self._end_stop
        self._end_margin = max(END_MARGIN[0], END_MARGIN[1] / actuator.acquisition.rate)
        self._speed = MOVE_SPEED * actuator.slew_speed
        self._return_timeout = RETURN_TIMEOUT + 2.0 * self._end_stop / self._speed
        self.stage = Stage.IDLE
        self._stream_timeout, self._test_timeout = stream_timeout, test_timeout
        self._begun = self._entered = 0.0
        self._origin = 0.0
        self._stamp, self._duration = 0, 0.0
        self._reason = ""

    def start(self, seen: Observation) -> list[Action]:
        """Begin a test, or refuse it."""
        if self.stage is not Stage.IDLE:
            return [Finish("a test is running already: wait for its end")]
        if seen.interlock:
            return [Finish(f"refused: {seen.interlock}")]
        self._begun = seen.now
        self._enter(Stage.FINDING, seen)
        return self.step(seen)

    def step(self, seen: Observation) -> list[Action]:
        """Return what is to be done at this moment."""
        if self.stage is Stage.IDLE:
            return []
        if self.stage in ENDING:
            return self._ending(seen)
        problem = self._problem(seen)
        if problem:
            return self._abort(problem, seen)
        if self.stage is Stage.FINDING:
            return self._finding(seen)
        if self.stage is Stage.POSITIONING:
            return self._positioning(seen)
        if self.stage is Stage.TESTING:
            return self._testing(seen)
        return self._counting(seen)

    def fail(self, reason: str, seen: Observation) -> list[Action]:
        """Abort because an action could not be done; where that was the last, all has ended.

        A test that ends already ends on: each abort would command the surface anew.
        """
        if self.stage is Stage.IDLE:
            return [Finish(f"aborted: {reason}")]
        if self.stage in ENDING:
            self._reason += f"; {reason}"
            return []
        return self._abort(reason, seen)

    def _enter(self, stage: Stage, seen: Observation) -> None:
        self.stage, self._entered = stage, seen.now

    def _problem(self, seen: Observation) -> str:
        """Return why the test cannot go on; empty: it can."""
        if seen.stop:
            return "interrupted"
        if seen.interlock:
            return seen.interlock
        if seen.abort:
            return "the test was asked to end"
        if self.stage is Stage.FINDING:
            return ""
        if seen.foreign_command:
            return "pre-empted: another node commands the actuator"
        silence = "" if self.stage is Stage.COUNTING else self._silence(seen)
        if silence:
            return silence
        if seen.now - self._begun > self._test_timeout:
            return f"not finished after {self._test_timeout:g} s"
        return ""

    def _silence(self, seen: Observation) -> str:
        """Return that nothing is heard where something is due; empty: it is.

        Where samples come after the move the status alone says, while it lasts, that the
        actuator lives.
        """
        begin = self._entered
        if seen.actuator is not None and seen.actuator.captures:
            mute = seen.now - max(seen.actuator_heard, begin)
            if mute > ACTUATOR_TIMEOUT:
                return f"no status for {mute:.1f} s: the driver has stopped"
            begin += self._duration
        silent = seen.now - max(seen.last_block, begin)
        if silent > self._stream_timeout:
            said = "" if seen.actuator is None else seen.actuator.complaint
            return f"no samples for {silent:.1f} s: " + (
                f"the actuator reports '{said}'" if said else "the acquisition has stopped")
        return ""

    def _finding(self, seen: Observation) -> list[Action]:
        if seen.foreign_command:
            self.stage = Stage.IDLE
            return [Finish("refused: another node commands the actuator")]
        actuator = seen.actuator
        waiting = seen.missing or (
            "no status '<node>: actuator' with its five keys on /diagnostics" if actuator is None
            else "the actuator executes another command" if actuator.active else ""
        )
        if waiting or actuator is None:
            if seen.now - self._entered <= FIND_TIMEOUT:
                return []
            self.stage = Stage.IDLE
            return [Finish(f"refused: {waiting}")]
        at = actuator.surface_position
        self._origin = self._within(at)
        if abs(at - self.profile.start) <= self._near:
            return self._begin_test(seen)
        self._enter(Stage.POSITIONING, seen)
        return [self._send(ramp(self._origin, self.profile.start, self._speed), seen)]

    def _positioning(self, seen: Observation) -> list[Action]:
        if not self._done(seen):
            return []
        assert seen.actuator is not None
        away = seen.actuator.surface_position - self.profile.start
        if abs(away) > self._near:
            return self._abort(
                f"the surface stays {1e3 * away:+.1f} mrad from the start of the test", seen
            )
        return self._begin_test(seen)

    def _begin_test(self, seen: Observation) -> list[Action]:
        self._enter(Stage.TESTING, seen)
        send = self._send(self.profile, seen)
        return [OpenRecord(self.profile, send.stamp), send]

    def _testing(self, seen: Observation) -> list[Action]:
        ended = self._accepted(seen) and seen.actuator is not None and not seen.actuator.active
        if seen.last_sample >= self.profile.duration or ended:
            self._enter(Stage.COUNTING, seen)
            return self._counting(seen)
        return []

    def _counting(self, seen: Observation) -> list[Action]:
        done = self._done(seen)
        if not done and seen.now - self._entered <= COUNT_TIMEOUT:
            return []
        if done and seen.last_sample < self.profile.duration - self._end_margin:
            return self._abort(
                f"the actuator ended the test at {max(seen.last_sample, 0.0):.3f} s of "
                f"{self.profile.duration:.3f} s", seen
            )
        self.stage = Stage.IDLE
        actuator = seen.actuator if self._accepted(seen) else None
        return [
            CloseRecord(
                "complete", actuator.start_time if actuator else None,
                actuator.samples_published if actuator else None,
            ),
            Finish(""),
        ]

    def _ending(self, seen: Observation) -> list[Action]:
        """Wait for the surface; it is sent nowhere while the interlock is open."""
        if self.stage is Stage.RETURNING and (seen.interlock or seen.abort):
            return self._stop(seen)
        stopping = self.stage is Stage.STOPPING
        done = self._at_rest(seen) if stopping else self._done(seen)
        if not done:
            limit = STOP_TIMEOUT if stopping else self._return_timeout
            if seen.now - self._entered <= limit and not seen.stop:
                return []
            where = "at rest" if stopping else "back"
            self._reason += f"; the surface is not confirmed to be {where}"
        self.stage = Stage.IDLE
        return [Finish(self._reason)]

    def _abort(self, reason: str, seen: Observation) -> list[Action]:
        stage = self.stage
        self._reason = ("" if seen.stop else "aborted: ") + reason
        actions: list[Action] = []
        if stage in (Stage.TESTING, Stage.COUNTING):
            actuator = seen.actuator if self._accepted(seen) else None
            actions.append(CloseRecord(
                "interrupted" if seen.stop else "aborted",
                actuator.start_time if actuator else None, None,
            ))
        if stage is Stage.FINDING or seen.foreign_command:
            self.stage = Stage.IDLE
            return [*actions, Finish(self._reason)]
        if seen.interlock or seen.abort:
            return [*actions, *self._stop(seen)]
        self._enter(Stage.RETURNING, seen)
        back = ramp(self._position(seen), self._origin, self._speed)
        return [*actions, self._send(back, seen)]

    def _stop(self, seen: Observation) -> list[Action]:
        """Command the surface to stay where it is."""
        self._enter(Stage.STOPPING, seen)
        return [self._send(step_to(self._position(seen)), seen)]

    def _position(self, seen: Observation) -> float:
        """Return where the surface is (rad), as the latest news of it say."""
        told = seen.actuator
        late = told is not None and (told.captures or seen.actuator_heard > seen.last_block)
        if seen.last_position is not None and not late:
            return self._within(seen.last_position)
        return self._origin if seen.actuator is None else self._within(
            seen.actuator.surface_position)

    def _within(self, position: float) -> float:
        """Return a position between the end stops (rad)."""
        return min(max(position, -self._end_stop), self._end_stop)

    def _send(self, profile: Profile, seen: Observation) -> SendCommand:
        self._stamp, self._duration = max(seen.stamp, self._stamp + 1), profile.duration
        return SendCommand(profile, self._stamp)

    def _accepted(self, seen: Observation) -> bool:
        """Whether the actuator reports on the last command sent."""
        return seen.actuator is not None and seen.actuator.command_stamp == self._stamp

    def _at_rest(self, seen: Observation) -> bool:
        """Whether the actuator, which may have stopped by itself, executes nothing."""
        idle = seen.actuator is not None and not seen.actuator.active
        return idle and seen.actuator_heard > self._entered

    def _done(self, seen: Observation) -> bool:
        """Whether the last command was executed and all of its samples have arrived."""
        return (
            self._accepted(seen)
            and seen.actuator is not None
            and not seen.actuator.active
            and (
                self.stage is Stage.RETURNING
                or seen.samples_received >= seen.actuator.samples_published
            )
        )
