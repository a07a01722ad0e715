"""Rules on two phase currents by themselves: over a whole electrical turn their mean is zero.

So an offset shows without the third current, whose sum with them would tell it. At low speed,
where the drive has voltage to spare, both have one size as well: that compares their gains.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ema_record.channels import CHANNELS, MOTOR_SPEED, ROTOR_ANGLE, TIME, median
from ema_record.checks.facts import CALIBRATE, REST_OFFSET, SLOW, BagFacts, Hit, Rule

TURN = 2.0 * np.pi
MEDIAN = 9
"""Steady turns on end whose median is taken."""
STEADY = (0.05, 0.1)
"""Relative changes of speed and of current to the turns beside it below which a turn is steady."""
KEPT = (0.1, 0.75)
"""What a sensor does it keeps doing: but for that share of the turns after it, so much of the
middle of them, and of the bound."""
STICKS = 0.1
"""Share of the motor's highest speed below which friction may stick and slip within a turn, which
makes one phase carry more than the other; such turns are not compared."""
LEAST_SAMPLES = 16
"""In a turn that counts."""
GAIN = (0.08, 8.0)
"""Relative difference of the two gains: at least, and times a good sensor's error."""
DRIVEN = 0.03
"""Mean size of a current from which gains are compared (of the limit)."""


class WholeTurns(NamedTuple):
    """Means of the two currents over electrical turns at steady speed, by angle; n of them.

    Attributes
    ----------
    time : ndarray, shape (n,) (s). Of the end of each turn.
    speed : ndarray, shape (n,) (rad/s). Mean size of the motor's.
    mean, size : ndarrays, shape (n, 2) (A). Of the currents, and of their magnitudes.
    """

    time: np.ndarray
    speed: np.ndarray
    mean: np.ndarray
    size: np.ndarray


def whole_turns(facts: BagFacts) -> WholeTurns | None:
    """Return the steady turns that were gone through in one direction, None: too few."""
    s, columns = facts.samples, facts.currents
    if len(s) < 2 or len(columns) != 2:
        return None
    if facts.has(ROTOR_ANGLE):
        path = np.unwrap(s[:, ROTOR_ANGLE])
    else:
        path = np.cumsum(s[:, MOTOR_SPEED]) * facts.interval * facts.actuator.motor.pole_pairs
    number = np.floor(path / TURN)
    edges = np.flatnonzero(np.diff(number)) + 1
    sense = number[edges] - number[edges - 1]
    step = np.abs(np.gradient(path))
    found = []
    for k in range(len(edges) - 1):
        rows = slice(int(edges[k]), int(edges[k + 1]))
        speed = np.abs(s[rows, MOTOR_SPEED]).mean()
        if (sense[k] != sense[k + 1] or rows.stop - rows.start < LEAST_SAMPLES
                or speed < STICKS * facts.actuator.control.speed_limit):
            continue
        weight = step[rows] / step[rows].sum()
        currents = s[rows][:, columns]
        found.append((s[rows.stop - 1, TIME], speed,
                      *(weight @ currents), *(weight @ np.abs(currents))))
    if len(found) < MEDIAN + 2:
        return None
    turns = np.array(found)
    unsteady = np.zeros(len(turns) - 2)
    for values, bound in ((turns[:, 1], STEADY[0]), (turns[:, 4:6].sum(axis=1), STEADY[1])):
        middle = values[1:-1]
        for beside in (values[:-2], values[2:]):
            unsteady = np.maximum(unsteady, np.abs(beside - middle) / (bound * middle))
    turns = turns[1:-1][unsteady < 1.0]
    if len(turns) < MEDIAN:
        return None
    return WholeTurns(turns[:, 0], turns[:, 1], turns[:, 2:4], turns[:, 4:6])


def offsets(facts: BagFacts) -> Iterator[Hit]:
    """Find a current of two that has a mean over turns, and keeps it from there on.

    A motor that sticks and slips has one too, of either sign.
    """
    found = facts.derived(whole_turns)
    if found is None:
        return
    bound = facts.offset_bound(REST_OFFSET)
    for column, means in zip(facts.currents, found.mean.T):
        kept = _first_kept(means, bound)
        if kept is not None:
            (first, mean), name = kept, CHANNELS[column].name
            yield Hit(f"{name} has a mean of {mean:+.2f} A over whole electrical turns, not zero",
                      float(found.time[first]), mean, "A", name)
            return


def _first_kept(values: np.ndarray, bound: float) -> tuple[int, float] | None:
    """Return from which turn on `values`, shape (n,), are beyond `bound` and stay so, and by what.

    A median of `MEDIAN` turns on end is beyond it, and each turn from then on is alike.
    """
    medians = median(np.lib.stride_tricks.sliding_window_view(values, MEDIAN), axis=-1)
    sense = np.sign(medians) * (np.abs(medians) > bound)
    for first in np.flatnonzero(np.diff(sense, prepend=0.0) * sense > 0.0).tolist():
        later = sense[first] * values[first + MEDIAN // 2:]
        if np.quantile(later, KEPT[0]) > KEPT[1] * max(bound, float(median(later))):
            return first, float(medians[first])
    return None


def gains(facts: BagFacts) -> Iterator[Hit]:
    """Find currents of two sizes at low speed."""
    found = facts.derived(whole_turns)
    if found is None:
        return
    least = DRIVEN * facts.actuator.inverter.current_limit
    slow = SLOW * facts.actuator.control.speed_limit
    use = (found.speed < slow) & (found.size.min(axis=1) > least)
    if use.sum() < MEDIAN:
        return
    ratio = found.size[use, 0] / found.size[use, 1] - 1.0
    kept = _first_kept(ratio, max(GAIN[0], GAIN[1] * facts.conditions.current_gain))
    if kept is not None:
        first, more = kept
        names = [CHANNELS[column].name for column in facts.currents]
        yield Hit(f"{names[0]} is {1.0 + more:.3f} times {names[1]} at low speed",
                  float(found.time[use][first]), more, "", "phase_current")


RULES = (
    Rule(name="sensor_scale", find=gains, remedy=CALIBRATE),
    Rule(name="sensor_offset", find=offsets, remedy=CALIBRATE),
)
