"""The moves that the monitor commands beside the test: there, back, and to stay."""

from __future__ import annotations

from ema_record.limits import MAX_DURATION
from ema_record.profile import Profile, load_profile_dict

ENDS = 0.1
"""Time before and after a move (s): the inverter comes on, the drive settles."""


def ramp(start: float, end: float, speed: float) -> Profile:
    """Return a move from `start` to `end` (rad) at `speed` (rad/s); faster where it never ends."""
    moving = min(max(abs(end - start) / speed, 1e-3), MAX_DURATION - 2.0 * ENDS)
    times = (0.0, ENDS, ENDS + moving, 2.0 * ENDS + moving)
    return _move(list(zip(times, (start, start, end, end))))


def step_to(position: float) -> Profile:
    """Return the command of one point: be at `position` (rad), at once."""
    return _move([(1e-3, position)])


def _move(points: list[tuple[float, float]]) -> Profile:
    return load_profile_dict({"name": "move", "points": points, "description": "move"}, "move")
