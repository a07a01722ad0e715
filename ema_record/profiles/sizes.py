"""How far and how fast the default tests move, from stroke, speed, gear and inertia.

All follows from the travel of the first step: the step back has 5/8 of it, the quarter-speed
slews 1/4, the slow ramps 1/32, so that each lasts as long. 64 turns of the rotor average what is
periodic in them, as the paper's step does (Battipede et al., section 4: 0.8 rad at gear 500).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

from ema_record.actuator import Actuator
from ema_record.errors import UsageError
from ema_record.profiles.motion import Capability, motion

TURNS, LEAST_ELECTRICAL_TURNS, QUARTER_TURNS = 64.0, 32.0, 12.0
"""Turns of the rotor in the first step; the least, electrical, for which more than the usual part
of the stroke is used; mechanical turns of a quarter-speed slew (8 of them settled)."""
SETTLED_TURNS = 28.0
"""Electrical turns that the paper's window holds where the slew does: 20 of a slow unit."""
USUAL_STROKE, MOST_STROKE = 2.0 / 3.0, 0.9
"""Part of the way to the end stops that is used; the most, where the turns are few."""
RAMP_TIME, LONGEST = 0.4, 8.0
"""Shortest slow ramp and longest full slew (s); the record is bounded to 60 s."""
QUARTER, SLOW = 1.0 / 4.0, 1.0 / 32.0
"""Speeds of slews and slow ramps, of the slew speed: friction at three speeds."""
PAPER_SETTLING, SETTLING = 10.0, 20.0
"""Time constants of the speed loop after the acceleration until the paper's window begins, and
until what is left of the transient lies below the lines' noise."""
WINDOW = 3.0 / 5.0
"""Length of the paper's window, of the full slew."""
TRANSIENT = 1.0 / 4.0
"""Part of a slew that is left out at its beginning, at most (full) or at least (quarter)."""
CROSSINGS, CROSSING_SAMPLES = 6.0, 100.0
"""Length of a slow ramp, in times that it takes to cross lost motion and wind-up, and the fewest
samples of that."""


class Sizes(NamedTuple):
    """Measures of the default tests of an actuator."""

    motion: Capability
    tick: float
    """Grid of times (s): a round number below acceleration and 1/40 of the slew."""
    settling: float
    """Until the paper's window, after a step (s)."""
    travel: float
    """Of the first step (rad)."""
    quarter_travel: float
    quarter_speed: float
    """Of the slews (rad, rad/s)."""
    ramp_travel: float
    ramp_speed: float
    """Of the slow ramps (rad, rad/s)."""
    window: tuple[float, float]
    """Analysis window of the paper's features (s after the command)."""


def round_number(value: float, steps: tuple[float, ...]) -> float:
    """Return the largest of `steps` (1 to 10) times a power of ten that is not above `value`."""
    decade = math.floor(math.log10(value) + 1e-9)
    unit = 10.0**decade
    best = max(s for s in steps if s <= value / unit + 1e-9)
    return round(best * unit, 12 - decade)


def crossing(actuator: Actuator, at: Capability, speed: float) -> float:
    """Return the time (s) from a reversal until the surface moves, at `speed` (rad/s).

    Lost motion, and wind-up of the shaft at twice the dynamic and static friction (a fault may
    double them), then an acceleration, or as long as `CROSSING_SAMPLES` take.
    """
    surface, shaft = actuator.surface, actuator.shaft
    wound = 2.0 * (surface.dynamic_friction + surface.static_friction) / shaft.stiffness
    least = CROSSING_SAMPLES / actuator.acquisition.rate
    return (shaft.backlash + wound) / speed + max(at.acceleration, least)


def settled(at: Capability, constants: float, length: float) -> float:
    """Return when a full slew of this length (s) has settled, after its command (s).

    That many time constants of the speed loop after the acceleration; where the slew is too short
    for them, the last of the transient is taken along, but never the acceleration.
    """
    return min(at.acceleration + constants * at.speed_loop,
               max(TRANSIENT * length, 2.0 * at.acceleration))


def braking(at: Capability, travel: float, slew: float) -> float:
    """Return when a slew over `travel` (rad) begins to brake (s after its command).

    The speed leaves its limit when the position error is less than the limit over the gain; the
    start has delayed the slew by half the acceleration.
    """
    return travel / slew - at.position_loop + 0.5 * at.acceleration


@lru_cache(maxsize=64)
def sizes(actuator: Actuator) -> Sizes:
    """Return the measures of the default tests.

    Raises
    ------
    UsageError
        The actuator cannot make its speed, or its stroke is too short (see `motion`).
    """
    at, slew, stop = motion(actuator), actuator.slew_speed, actuator.surface.end_stop
    turn = 2.0 * math.pi / actuator.gear.ratio
    settling = at.acceleration + PAPER_SETTLING * at.speed_loop
    least = max(LEAST_ELECTRICAL_TURNS / actuator.motor.pole_pairs * turn,
                slew * (4.0 * settling + at.position_loop))
    wanted = max(TURNS * turn, slew * max(RAMP_TIME, 6.0 * settling))
    travel = min(wanted, 2.0 * USUAL_STROKE * stop, max(LONGEST * slew, least))
    travel = max(travel, min(least, 2.0 * MOST_STROKE * stop))
    half = _down(0.5 * travel, 2)
    half = half if 2.0 * half >= least else _down(0.5 * travel, 4)
    travel = 2.0 * half
    quarter = min(max(QUARTER * travel, QUARTER_TURNS * turn), travel,
                  max(LONGEST * QUARTER * slew, QUARTER * travel))
    quarter = 2.0 * min(_up(0.5 * quarter, 3), half)
    # Speeds are round too, to a third of a percent of the slew speed.
    grid = 5e-3 * 10.0 ** math.floor(math.log10(slew))
    quarter_speed, ramp_speed = (grid * round(part * slew / grid) for part in (QUARTER, SLOW))
    length = max(RAMP_TIME, CROSSINGS * crossing(actuator, at, ramp_speed))
    ramp = _up(max(SLOW * travel, ramp_speed * length), 2)
    if ramp > half + 0.5 * quarter:
        raise UsageError(
            f"a stroke of +-{stop:g} rad leaves {half + 0.5 * quarter:.3g} rad for a slow ramp "
            f"across lost motion and wind-up of the shaft, which needs {ramp:.3g}: a longer "
            "stroke, a lower control.speed_limit or a stiffer shaft")
    tick = round_number(min(at.acceleration, travel / slew / 40.0), (1.0, 2.0, 5.0))
    settling = settled(at, PAPER_SETTLING, travel / slew)
    begin = up(settling, tick)
    settled_from = settled(at, SETTLING, travel / slew)
    turning = actuator.motor.pole_pairs * actuator.control.speed_limit / (2.0 * math.pi)
    end = max(down(begin + WINDOW * travel / slew, tick),
              up(settled_from + SETTLED_TURNS / turning, tick))
    end = min(end, nearest(braking(at, travel, slew), tick))
    return Sizes(at, tick, settling, travel, quarter, round(quarter_speed, 9), ramp,
                 round(ramp_speed, 9), (begin, end))


def up(time: float, tick: float) -> float:
    """Return the first multiple of `tick` not before `time` (s)."""
    return round(math.ceil(time / tick - 1e-6) * tick, 9)


def down(time: float, tick: float) -> float:
    """Return the last multiple of `tick` not after `time` (s)."""
    return round(math.floor(time / tick + 1e-6) * tick, 9)


def nearest(time: float, tick: float) -> float:
    """Return the multiple of `tick` nearest to `time` (s)."""
    return round(round(time / tick) * tick, 9)


def before(time: float, tick: float) -> float:
    """Return the last multiple of `tick` before `time` (s)."""
    return round((math.ceil(time / tick - 1e-6) - 1) * tick, 9)


def _down(value: float, digits: int) -> float:
    unit = 10.0 ** (math.floor(math.log10(value) + 1e-9) + 1 - digits)
    return round(math.floor(value / unit + 1e-6) * unit, 12)


def _up(value: float, digits: int) -> float:
    unit = 10.0 ** (math.floor(math.log10(value) + 1e-9) + 1 - digits)
    return round(math.ceil(value / unit - 1e-6) * unit, 12)
