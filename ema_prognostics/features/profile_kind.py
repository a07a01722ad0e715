"""Which of the trained tests a profile is.

A profile is known by its points and not by its name: a bag recorded elsewhere has only the
command.
"""

from __future__ import annotations

from typing import Literal

from ema_record.actuator import Actuator, load_actuator
from ema_record.profile import Profile, load_profile

ProfileKind = Literal["step", "extended"]
TOLERANCE = 2e-3
"""Largest difference of a point in time (s) and in position (rad)."""
SLEWING = 0.98
"""Share of its highest speed that the surface reaches at least in a full slew."""
SLEW_LENGTH = 0.36
"""How long after its command a step must go on slewing (s)."""


def _same(a: Profile, b: Profile) -> bool:
    """Whether both command the same after the first command."""
    begin_a, begin_b = a.command_time, b.command_time
    first = [(t - begin_a, x) for t, x in a.points if t >= begin_a]
    second = [(t - begin_b, x) for t, x in b.points if t >= begin_b]
    return len(first) == len(second) and all(
        abs(t - u) <= TOLERANCE and abs(x - y) <= TOLERANCE
        for (t, x), (u, y) in zip(first, second)
    )


def profile_kind(profile: Profile, actuator: Actuator | None = None) -> ProfileKind | None:
    """Return which trained test `profile` is, or None.

    Every profile whose first step keeps the actuator slewing at full speed through the
    analysis window counts as a step, of either sign. The slew speed is that of `actuator`,
    default the nominal one.
    """
    if _same(profile, load_profile("extended")):
        return "extended"
    begin = profile.command_time
    steps = [
        x1 - x0
        for (t0, x0), (t1, x1) in zip(profile.points, profile.points[1:])
        if t0 == t1 == begin
    ]
    later = [t for t, _ in profile.points if t > begin]
    slew = SLEWING * (load_actuator() if actuator is None else actuator).slew_speed
    if not steps or not later or abs(sum(steps)) < slew * SLEW_LENGTH + 0.02:
        return None
    after = [x for t, x in profile.points if begin < t < begin + SLEW_LENGTH]
    held = all(abs(x - profile.points[-1][1]) < TOLERANCE for x in after)
    return "step" if held and later[-1] >= begin + SLEW_LENGTH else None
