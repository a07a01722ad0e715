"""The default tests of any actuator: `step`, the paper's, and `extended`.

Full slews, quarter-speed slews both ways, slow ramps both ways and a reversal, as far and as
fast as `sizes` says. A slew ends with a rest until the position control has arrived.
"""

from __future__ import annotations

import math

from ema_record.actuator import Actuator
from ema_record.errors import UsageError
from ema_record.limits import MAX_DURATION
from ema_record.profile import Profile
from ema_record.profiles.plan import LEAST_TURNS, test_plan
from ema_record.profiles.sizes import Sizes, crossing, sizes, up

OFF, OFF_SAMPLES, GUARD = 0.020, 50, 1e-3
"""Time without current (s) and samples in it: offsets of the current sensors are read there, but
for a guard time before the inverter switches on (s)."""
REST = 0.002
"""From switching on to the first command (s)."""
ARRIVAL, BRAKING = 2.5, 3.0
"""After a full slew the surface rests from so many time constants of the position control, or
times of acceleration, on."""


def default_profiles(actuator: Actuator) -> dict[str, Profile]:
    """Return the tests ``step`` and ``extended`` for an actuator.

    Raises
    ------
    UsageError
        It cannot make its own speed, its stroke holds too few turns of the rotor, or the test
        would take longer than a record may.
    """
    size = sizes(actuator)
    off = max(OFF, math.ceil(1e3 * (GUARD + OFF_SAMPLES / actuator.acquisition.rate)) * 1e-3)
    first, window = _clear(off + REST), size.window
    if first + window[1] < 0.0 or window[0] + window[1] <= 0.0:
        raise UsageError(
            f"no slew settles within its stroke ({size.travel:.3g} rad): raise "
            "control.position_gain, lower control.speed_limit, or check surface.end_stop")
    half = 0.5 * size.travel
    step = [(0.0, -half), (first, -half), (first, half),
            (up(first + window[1] + window[0], size.tick), half)]
    words = {"step": f"step from {-half:g} to +{half:g} rad at {first:g} s",
             "extended": "step, quarter-speed slews, slow ramps both ways, reversal"}
    extended = _extended(actuator, size, first)
    if (duration := extended[-1][0]) > MAX_DURATION:
        raise UsageError(
            f"the test would take {duration:.0f} s, at most {MAX_DURATION:g}: at "
            f"{actuator.slew_speed:.3g} rad/s the surface is too slow for its stroke and wind-up: "
            "raise control.speed_limit or check shaft.stiffness")
    made = {
        name: Profile(
            name=name, points=tuple(points), inverter_off=_clear(off), description=words[name],
            window=(_clear(first + window[0]), _clear(first + window[1])))
        for name, points in (("step", step), ("extended", extended))
    }
    _check(actuator, size, made)
    return made


def _clear(value: float) -> float:
    """Return `value` without the dust of its computation."""
    return round(value, 9)


def _extended(actuator: Actuator, size: Sizes, first: float) -> list[tuple[float, float]]:
    """Return the points of the test ``extended``; the first command is at `first` (s)."""
    at, slew = size.motion, actuator.slew_speed
    half, low = 0.5 * size.travel, -0.5 * size.quarter_travel
    rest = max(ARRIVAL * at.position_loop, BRAKING * at.acceleration)
    second = up(first + size.travel / slew + rest, size.tick)
    third = up(second + (half - low) / slew + rest, size.tick)
    slew_time = size.quarter_travel / size.quarter_speed
    ahead = third + slew_time
    back = up(ahead + at.acceleration, size.tick)
    arrived = back + slew_time
    ramp = up(arrived + 2.0 * at.acceleration, size.tick)
    length = size.ramp_travel / size.ramp_speed
    across = crossing(actuator, at, size.ramp_speed)
    turn = ramp + 2.0 * length
    end = up(turn + across + 2.0 * size.tick, size.tick)
    points = [
        (0.0, -half), (first, -half), (first, half), (second, half), (second, low), (third, low),
        (ahead, -low), (back, -low), (arrived, low), (ramp, low),
        (ramp + length, low + size.ramp_travel), (turn, low),
        (end, low + size.ramp_speed * (end - turn)),
    ]
    return [(round(t, 5), round(x, 9)) for t, x in points]


def _check(actuator: Actuator, size: Sizes, made: dict[str, Profile]) -> None:
    """Raise UsageError unless the tests can be made and hold the turns that they need."""
    turns = actuator.gear.ratio / (2.0 * math.pi)
    stop, slew = actuator.surface.end_stop, actuator.slew_speed
    try:
        complete = (test_plan(made["step"], actuator) is not None
                    and test_plan(made["extended"], actuator).is_extended)
    except UsageError:
        complete = False
    if not complete:
        raise UsageError(
            f"a stroke of +-{stop:g} rad is too short: {size.travel:.3g} rad are "
            f"{size.travel * turns:.3g} turns of the rotor and {1e3 * size.travel / slew:.3g} ms "
            f"at {slew:.3g} rad/s, of which {1e3 * size.settling:.3g} ms settle and fewer than "
            f"{LEAST_TURNS} electrical turns are left: a longer stroke, a lower "
            "control.speed_limit or a faster control")
    for profile in made.values():
        profile.check_within(stop)
