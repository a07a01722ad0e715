"""Which of the trained tests a profile is.

A profile is known by its points and not by its name: a bag recorded elsewhere has only the
command.
"""

from __future__ import annotations

from typing import Literal

from ema_record.actuator import Actuator, load_actuator
from ema_record.profile import Profile, load_profile, profile_names
from ema_record.profiles.plan import test_plan

ProfileKind = Literal["step", "extended"]
SAME_TIME = 2e-3
"""Largest difference of a point in time (s)."""
SAME_POSITION = 1.0 / 300.0
"""Largest difference of a point in position, of the way to an end stop."""
SLEWING, BRAKING = 0.98, 0.04
"""Share of its highest speed that the surface reaches at least in a full slew, and of the slew
that is left for braking."""


def _same(a: Profile, b: Profile, tolerance: float) -> bool:
    """Whether both command the same after the first command, positions to `tolerance` (rad)."""
    begin_a, begin_b = a.command_time, b.command_time
    first = [(t - begin_a, x) for t, x in a.points if t >= begin_a]
    second = [(t - begin_b, x) for t, x in b.points if t >= begin_b]
    return len(first) == len(second) and all(
        abs(t - u) <= SAME_TIME and abs(x - y) <= tolerance
        for (t, x), (u, y) in zip(first, second)
    )


def profile_kind(profile: Profile, actuator: Actuator | None = None) -> ProfileKind | None:
    """Return which trained test `profile` is, or None.

    Every profile whose first step keeps the actuator slewing at full speed through the
    analysis window counts as a step, of either sign. The slew speed is that of `actuator`,
    default the nominal one.
    """
    actuator = load_actuator() if actuator is None else actuator
    tolerance = SAME_POSITION * actuator.surface.end_stop
    names = profile_names()
    if "extended" in names and _same(profile, load_profile("extended"), tolerance):
        return "extended"
    if "step" not in names:
        return None
    length = test_plan(load_profile("step"), actuator).last_time
    begin = profile.command_time
    steps = [
        x1 - x0
        for (t0, x0), (t1, x1) in zip(profile.points, profile.points[1:])
        if t0 == t1 == begin
    ]
    later = [t for t, _ in profile.points if t > begin]
    travel = (SLEWING + BRAKING) * actuator.slew_speed * length
    if not steps or not later or abs(sum(steps)) < travel:
        return None
    after = [x for t, x in profile.points if begin < t < begin + length]
    held = all(abs(x - profile.points[-1][1]) < tolerance for x in after)
    return "step" if held and later[-1] >= begin + length else None
