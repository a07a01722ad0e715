"""What a profile asks of the drive: sections of constant speed, and the changes between them.

Read off the commanded trajectory, with the speed of the drive limited as the position control
limits it; so any profile has segments, not only the shipped ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ema_record.actuator import Actuator
from ema_record.profile import Profile

Kind = Literal["slew", "ramp", "hold"]
Change = Literal["start", "reversal", "stop"]

GRID = 1e-3
"""Interval of the plan (s)."""
SLOW, STILL = 0.076, 0.0013
"""Below these shares of the speed limit a segment is a ramp, or a hold."""
SHORTEST = 0.030
"""Shorter sections belong to the change (s)."""
SETTLE = {"slew": 0.070, "ramp": 0.100, "hold": 0.020}
"""Left out at the beginning of a segment (s)."""
END_GUARD = 0.010
"""Left out at the end of a slew or ramp (s)."""
STEPPED = 0.38
"""A larger change of the motor speed is a step, a share of the speed limit."""
CHANGED = 0.0025
"""A larger one, of that and at least a fiftieth of the speed, ends a section."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionSegment:
    """A part of a test at constant speed, without its beginning and end."""

    name: str
    kind: Kind
    begin: float
    """s since the acceptance of the command."""
    end: float
    speed: float
    """Planned motor speed (rad/s), signed."""

    @property
    def text(self) -> str:
        """For people."""
        if self.kind == "hold":
            return f"hold at {self.begin:.2f} to {self.end:.2f} s"
        return f"{self.kind} at {self.speed:+.0f} rad/s, {self.begin:.2f} to {self.end:.2f} s"


@dataclass(frozen=True, slots=True, kw_only=True)
class Transition:
    """A change of speed between two sections."""

    name: str
    kind: Change
    time: float
    """s since the acceptance of the command."""
    room: float
    """Time until the next change or the end (s)."""
    before: float
    """Motor speed (rad/s)."""
    after: float
    stepped: bool
    """Whether the drive is asked for a jump of its speed."""

    @property
    def text(self) -> str:
        """For people."""
        return (f"{self.kind} at {self.time:.3f} s from {self.before:+.0f} to "
                f"{self.after:+.0f} rad/s")


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionPlan:
    """Segments and transitions of a profile, in order of time."""

    segments: tuple[MotionSegment, ...]
    transitions: tuple[Transition, ...]


def path(profile: Profile, actuator: Actuator) -> tuple[np.ndarray, np.ndarray]:
    """Return times, shape (n,) (s), and the positions that the drive can reach (rad)."""
    limit = actuator.control.speed_limit / actuator.gear.ratio
    times = np.arange(0.0, profile.duration, GRID)
    command = profile.command(times + 0.5 * GRID)
    place = np.empty(len(times) + 1)
    place[0] = profile.start
    for k, goal in enumerate(command):
        off = times[k] < profile.inverter_off
        step = 0.0 if off else float(np.clip(goal - place[k], -limit * GRID, limit * GRID))
        place[k + 1] = place[k] + step
    return np.append(times, times[-1] + GRID), place


def plan(profile: Profile, actuator: Actuator) -> MotionPlan:
    """Return the segments and transitions of a profile."""
    times, place = path(profile, actuator)
    times = times[:-1]
    speed = np.diff(place) / GRID * actuator.gear.ratio
    limit = actuator.control.speed_limit
    sections = _sections(times, speed, profile.duration, CHANGED * limit)
    segments: list[MotionSegment] = []
    transitions: list[Transition] = []
    for index, (begin, end, value) in enumerate(sections):
        part = abs(value) / limit
        kind: Kind = "hold" if part < STILL else "ramp" if part < SLOW else "slew"
        first = begin + (SETTLE[kind] if index else 0.0)
        last = end - (END_GUARD if kind != "hold" else 0.0)
        if index and last - first >= SHORTEST:
            segments.append(MotionSegment(name=f"s{len(segments) + 1}", kind=kind, begin=first,
                                          end=last, speed=value))
        if index:
            before = sections[index - 1][2]
            change: Change = (
                "stop" if kind == "hold" else "reversal" if before * value < 0.0 else "start"
            )
            transitions.append(Transition(
                name=f"t{index}", kind=change, time=begin, room=end - begin, before=before,
                after=value,
                stepped=change != "stop" and abs(value - before) > STEPPED * limit))
    return MotionPlan(segments=tuple(segments), transitions=tuple(transitions))


def _sections(
    times: np.ndarray, speed: np.ndarray, duration: float, changed: float
) -> list[tuple[float, float, float]]:
    """Return (begin, end, motor speed) of the stretches of constant speed; short ones merged."""
    edges = 1 + np.flatnonzero(
        np.abs(np.diff(speed)) > np.maximum(changed, 0.02 * np.abs(speed[1:])))
    bounds = [0, *edges.tolist(), len(times)]
    found: list[tuple[float, float, float]] = []
    for a, b in zip(bounds, bounds[1:]):
        if (b - a) * GRID < 0.010 and found:  # the corner of a step on the grid
            begin, _, value = found[-1]
            found[-1] = (begin, float(times[b - 1] + GRID), value)
            continue
        end = duration if b == len(times) else float(times[b - 1] + GRID)
        begin = found[-1][1] if found else 0.0
        found.append((begin, end, float(np.median(speed[a:b]))))
    return found
