"""Which parts of a test tell what: settled slews, slow ramps, reversals, starts.

All times are in seconds after the first command. They follow from the points of the profile and
from what the actuator can do; the rules stand beside the constants here and in `sizes`. Begins
are rounded up to the grid of the actuator's tests, ends down to a whole number of ticks of their
leg, so that equal tests have equal windows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ema_record.actuator import Actuator
from ema_record.errors import UsageError
from ema_record.profile import Profile
from ema_record.profiles.sizes import (
    SETTLING,
    SLOW,
    TRANSIENT,
    Sizes,
    before,
    braking,
    crossing,
    down,
    nearest,
    settled,
    sizes,
    up,
)

FULL, FAST = 0.9, 2.0 * SLOW
"""Of the slew speed: commands from FULL on are slews at full speed, below FAST slow ramps."""
RAMP_FROM_REST, RAMP_TURNED = 1.5, 2.0
"""Crossings of lost motion and wind-up until a slow ramp is steady; after a turn without rest the
whole wind-up is to be crossed."""
APPROACH = 5.0
"""Time constants of the position control until a quarter-speed slew is steady (e⁻⁵ is 0.7 %)."""
CLOSE = 0.05
"""Of the slew speed: nearer to its speed than this a slew has ended its start."""
FEWEST = 0.7
"""Of the turns expected in a segment: a worn or cold unit is slower."""
LEAST_TURNS = 4
"""Fewest electrical turns in a segment."""
R10 = (1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0)
"""Preferred numbers (ISO 3): the fewest turns are one of them."""

Window = tuple[float, float]
"""Begin and end (s after the first command)."""


class SettledSlew(NamedTuple):
    """The settled part of a slew."""

    begin: float
    end: float
    turns: int
    """Fewest electrical turns of the rotor that it must hold."""


class TestPlan(NamedTuple):
    """Parts of a test (s after the first command); None where the profile has no such part."""

    full: SettledSlew
    full_back: SettledSlew | None
    quarter: SettledSlew | None
    quarter_back: SettledSlew | None
    ramp: Window | None
    ramp_back: Window | None
    reversals: tuple[tuple[float, int], ...]
    """Begin, and sense of the motor after it, of each turn of the slow ramps."""
    reversal_length: float
    """How long the motion goes on after each (s): lost motion takes its width to cross; or 0."""
    starts: tuple[Window, ...]
    """Where the motor accelerates and brakes."""
    full_speed: Window
    """The paper's window: at the limit of the speed."""
    slow_from: float
    """When the slow ramps begin, infinite without them."""
    last_time: float
    """What a record must cover at least."""
    acceleration: float
    """Time from rest to the slew speed (s)."""

    @property
    def segments(self) -> dict[str, SettledSlew]:
        """The settled slews that there are, by name."""
        named = {"full": self.full, "full_back": self.full_back, "quarter": self.quarter,
                 "quarter_back": self.quarter_back}
        return {name: part for name, part in named.items() if part is not None}

    @property
    def ramps(self) -> dict[str, Window]:
        """The slow ramps that there are, by name."""
        named = {"ramp": self.ramp, "ramp_back": self.ramp_back}
        return {name: part for name, part in named.items() if part is not None}

    @property
    def is_extended(self) -> bool:
        """Whether every part is there; else it is a step."""
        return (len(self.segments), len(self.ramps), len(self.reversals)) == (4, 2, 2)


# Names that begin with "test" are no tests.
TestPlan.__test__ = False  # type: ignore[attr-defined]


class Leg(NamedTuple):
    """A part of a profile in which the command moves."""

    begin: float
    """s after the first command."""
    end: float
    """When the command, or the surface at its slew speed, arrives (s)."""
    until: float
    """When the command moves again, or the test ends (s)."""
    travel: float
    """Signed (rad)."""
    speed: float
    """Of the slew speed, at most 1."""

    @property
    def sense(self) -> int:
        """+1 or -1."""
        return 1 if self.travel > 0.0 else -1


def legs(profile: Profile, actuator: Actuator) -> list[Leg]:
    """Return the legs of `profile` for an actuator of this slew speed."""
    slew, start = actuator.slew_speed, profile.command_time
    moves: list[list[float]] = []
    for (t0, x0), (t1, x1) in zip(profile.points, profile.points[1:]):
        if x1 == x0:
            continue
        if t1 == t0 and moves and moves[-1][0] == moves[-1][1] == t0:
            moves[-1][2] += x1 - x0
        else:
            moves.append([t0, t1, x1 - x0])
    found = []
    for k, (t0, t1, travel) in enumerate(moves):
        until = moves[k + 1][0] if k + 1 < len(moves) else profile.duration
        length = max(t1 - t0, abs(travel) / slew)
        found.append(Leg(t0 - start, t0 - start + length, until - start, travel,
                         abs(travel) / length / slew))
    return found


def test_plan(profile: Profile, actuator: Actuator) -> TestPlan:
    """Return which parts of `profile` tell what on an actuator.

    Raises
    ------
    UsageError
        It has no slew long enough to settle at full speed, or the actuator cannot make its own
        speed (see `sizes`).
    """
    size = sizes(actuator)
    made = legs(profile, actuator)
    fast = [leg for leg in made if leg.speed >= FULL]
    middle = [leg for leg in made if FAST <= leg.speed < FULL]
    slow = [leg for leg in made if leg.speed < FAST]
    window = _window(profile, size)
    full = _full(fast[0], size, actuator, window[1]) if fast else None
    if full is None:
        raise UsageError(
            f"profile {profile.name!r} has no slew long enough to settle at full speed: "
            f"{size.travel:g} rad at once are right for this actuator")
    ramps = _slow(slow, size, actuator)
    turned = [b for a, b in zip(slow, slow[1:]) if _turned(a, b)]
    turns = [(round(b.begin, 9), b.sense) for b in turned]
    length = needed = 0.0
    if turns:
        speed = slow[0].speed * actuator.slew_speed
        length = min(down(b.end - b.begin, 1e-3) for b in turned[:2])
        # A test that was designed before its actuator was corrected may end sooner.
        needed = min(length, up(crossing(actuator, size.motion, speed), 0.5 * size.tick))
    last = max([full.end, *(begin + needed for begin, _ in turns)])
    back = _back(fast)
    quarter_back = _back(middle)
    return TestPlan(
        full=full,
        full_back=None if back is None else _full(back, size, actuator, math.inf),
        quarter=_quarter(middle[0], size, actuator) if middle else None,
        quarter_back=None if quarter_back is None else _quarter(quarter_back, size, actuator),
        ramp=ramps[0], ramp_back=ramps[1], reversals=tuple(turns[:2]), reversal_length=length,
        starts=_starts([leg for leg in made if leg.speed >= FAST], size),
        full_speed=(min(window[0], full.begin), full.end),
        slow_from=round(slow[0].begin, 9) if slow else math.inf,
        last_time=round(last, 9), acceleration=size.motion.acceleration,
    )


test_plan.__test__ = False  # type: ignore[attr-defined]


def _window(profile: Profile, size: Sizes) -> Window:
    """Return the paper's window: the profile's own, where that begins when slews have settled."""
    if profile.window is not None:
        begin, end = (round(t - profile.command_time, 9) for t in profile.window)
        if size.motion.acceleration <= begin <= 2.0 * size.window[0] and end > begin:
            return begin, end
    return size.window


def _back(group: list[Leg]) -> Leg | None:
    """Return the first leg against the sense of the first one."""
    return next((leg for leg in group if leg.sense != group[0].sense), None)


def _turned(a: Leg, b: Leg) -> bool:
    """Whether `b` turns round where `a` ends, without rest."""
    return a.sense != b.sense and abs(b.begin - a.end) < 1e-6


def _segment(begin: float, end: float, share: float, actuator: Actuator) -> SettledSlew | None:
    """Return the segment, or None where it holds too few turns."""
    speed = share * actuator.control.speed_limit * actuator.motor.pole_pairs
    expected = FEWEST * speed * (end - begin) / (2.0 * math.pi)
    if expected < LEAST_TURNS:
        return None
    decade = 10.0 ** math.floor(math.log10(expected))
    fewest = int(max(r * decade for r in R10 if r * decade <= expected) + 1e-9)
    return SettledSlew(begin, end, fewest)


def _full(leg: Leg, size: Sizes, actuator: Actuator, latest: float) -> SettledSlew | None:
    """Return the settled part of a slew at full speed, which ends before it brakes."""
    settling = settled(size.motion, SETTLING, leg.end - leg.begin)
    brakes = braking(size.motion, abs(leg.travel), actuator.slew_speed)
    end = leg.begin + min(nearest(brakes, size.tick), before(leg.until - leg.begin, size.tick))
    return _segment(up(leg.begin + settling, size.tick), round(min(end, latest), 9), leg.speed,
                    actuator)


def _quarter(leg: Leg, size: Sizes, actuator: Actuator) -> SettledSlew | None:
    length = leg.end - leg.begin
    settling = max(TRANSIENT * length, _start_of_ramp(leg, None, size),
                   min(APPROACH * size.motion.position_loop, 0.5 * length))
    return _segment(up(leg.begin + settling, size.tick),
                    round(leg.begin + before(length, size.tick), 9), leg.speed, actuator)


def _slow(slow: list[Leg], size: Sizes, actuator: Actuator) -> tuple[Window | None, Window | None]:
    """Return the steady parts of the first slow ramp and of the one back."""
    found: list[Window | None] = [None, None]
    for k, leg in enumerate(slow[:2]):
        turned = k > 0 and _turned(slow[k - 1], leg)
        across = crossing(actuator, size.motion, leg.speed * actuator.slew_speed)
        wait = max((RAMP_TURNED if turned else RAMP_FROM_REST) * across,
                   4.0 * size.motion.position_loop)
        begin = up(leg.begin + wait, size.tick)
        end = round(leg.begin + before(leg.end - leg.begin, size.tick), 9)
        if end - begin >= 2.0 * size.tick and (k == 0 or turned):
            found[k] = (begin, end)
    return found[0], found[1]


def _start_of_ramp(leg: Leg, previous: Leg | None, size: Sizes) -> float:
    """Return how long a slew that is commanded as a ramp takes to come close to its speed (s).

    The position control approaches it exponentially, from rest or from the slew before.
    """
    at = size.motion
    change = leg.speed
    if previous is not None and leg.begin - previous.end < at.position_loop:
        change += previous.speed if previous.sense != leg.sense else 0.0
    return max(at.position_loop * math.log(max(change / CLOSE, 1.0)),
               change * size.settling)


def _starts(moves: list[Leg], size: Sizes) -> tuple[Window, ...]:
    """Return the first start, and from each braking to the end of the start after it."""
    found = []
    previous: Leg | None = None
    for leg in moves:
        is_step = leg.speed >= FULL
        settled = size.settling if is_step else _start_of_ramp(leg, previous, size)
        begin = leg.begin
        if previous is not None:
            brakes = (previous.begin + (previous.end - previous.begin)
                      - size.motion.position_loop + size.motion.acceleration
                      if previous.speed >= FULL else previous.end)
            begin = down(brakes - 2.0 * size.tick, size.tick)
        found.append((max(round(begin, 9), 0.0), up(leg.begin + settled, size.tick)))
        previous = leg
    return tuple(found)
