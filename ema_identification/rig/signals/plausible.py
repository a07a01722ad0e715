"""Columns that cannot be what they are called: wrong unit, swapped, wrapped, reversed, clipped.

Each is said by name before any law leans on it: a wrong sign alone would end as backlash, cogging
and compliance. Position and speed are compared with each other, the input with what any axis
does: inertia and friction take energy, they do not give any.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import optimize

from ema_identification.rig.signals.trajectory import Trajectory, low_pass
from ema_record.errors import InvalidRecordError
from ema_rig.record import POSITION, SPEED, RigRecord

GAP = 10.0
"""Intervals longer than so many median ones cut the record; shorter ones are interpolated."""
TOLERANCE = 0.05
"""Of the ratio of speed to the derivative of position."""
FOLLOWS = 0.9
"""Least correlation of the integral of the speed with the position."""
SURE = 0.98
"""The same of two columns that are taken for each other."""
STILL = 2.0
"""Spread of a position over that of its steps; white noise has 0.7."""
RUN = ("record a run with reversals and at least two speeds, for example a sine or trapezoids of "
       "speed")
JUMP = 0.5
"""A step of the position by this share of its travel is a jump ..."""
ALIKE = 0.05
"""... and jumps that differ by less than this share of the travel are of one counter."""
BACK = 0.4
"""Share of the samples beside jumps that jump too, above which they are spikes."""
TURNED = 0.5
"""Of what an input leaves as it is, a reversed one leaves less than this share when turned ..."""
LEAST = 0.3
"""... and is then explained by this share of its squares at least."""
SOME = 0.05
"""Least share that an input leaves for it to be tried in the place of the motion."""
RESTORED = 0.3
"""The same of an input whose sign is lost."""
PLATEAU, FEW = 2.0, 0.005
"""Samples at the extreme of a clipped input, over those in the fiftieth of its range below; and
their least share of all."""
FIT_ROWS = 60

_RATIOS = {
    "rotary": {
        60.0 / (2 * math.pi): "speed is in rev/min (rpm), not rad/s",
        180.0 / math.pi: "speed is in deg/s, or position in units of 57.3 degrees less",
        1.0 / (2 * math.pi): "speed is in rev/s, not rad/s",
        math.pi / 180.0: "position is in degrees, not rad",
        2 * math.pi: "position is in turns, not rad",
        1.0 / 6.0: "speed is in rev/min (rpm) and position in degrees",
        60.0: "speed is in rev/min (rpm) and position in turns",
        1000.0: "time is in ms, not s (or position in units of a thousandth)",
        1e6: "time is in us, not s",
        1e-3: "time is in s, not ms",
    },
    "linear": {
        1000.0: "speed is in mm/s and position in m, or time in ms",
        1e-3: "position is in mm and speed in m/s",
        100.0: "speed is in cm/s and position in m",
        0.01: "position is in cm and speed in m/s",
        60.0: "speed is in m/min, not m/s",
        1000.0 * 60.0: "speed is in mm/min, not m/s",
        1e6: "time is in us, not s",
    },
}


def check_columns(record: RigRecord) -> None:
    """Compare the speed with the derivative of the position, where both are measured.

    Raises
    ------
    InvalidRecordError
        The position jumps as a counter that starts again; speed and position do not belong
        together, or their ratio is not 1: the column or the unit that it suggests is named.
    """
    if record.has(POSITION):
        _check_wraps(record)
    if not (record.has(POSITION) and record.has(SPEED)):
        return
    time, position, speed = record.time, record.channel(POSITION), record.channel(SPEED)
    ratio, quality = _ratio(time, position, speed)
    if quality >= FOLLOWS and abs(ratio - 1.0) <= TOLERANCE:
        return
    swapped = exchanged(record)
    if swapped is not None:
        raise InvalidRecordError(f"{record.source}: {swapped}: exchange their columns in the map")
    if quality < FOLLOWS and np.std(position) < STILL * np.std(np.diff(position)):
        raise InvalidRecordError(
            f"{record.source}: no excitation: the position is noise about one place: {RUN}")
    if not math.isfinite(ratio) or quality < FOLLOWS:
        raise InvalidRecordError(
            f"{record.source}: the speed does not follow the position (correlation of its "
            f"integral {quality:.2f}, at least {FOLLOWS:g}): check the columns of the map"
        )
    if abs(ratio + 1.0) <= TOLERANCE:
        raise InvalidRecordError(
            f"{record.source}: speed and position have opposite signs: set 'scale: -1' for one "
            "of them in the map"
        )
    known = _RATIOS[record.axis.motion]
    near = min(known, key=lambda value: abs(math.log(abs(ratio) / value)))
    guess = f": {known[near]}" if abs(abs(ratio) / near - 1.0) <= TOLERANCE else ""
    raise InvalidRecordError(
        f"{record.source}: the speed integrates to {ratio:.4g} times the position{guess}: "
        "correct the unit or the scale in the map and import again"
    )


def exchanged(record: RigRecord) -> str | None:
    """Return which columns are swapped, None where no exchange makes a speed of a position."""
    time, drive = record.time, record.input
    position, speed = record.channel(POSITION), record.channel(SPEED)
    ratio, quality = _ratio(time, speed, position)
    if quality > SURE and abs(ratio - 1.0) <= TOLERANCE:
        return "position and speed are swapped"
    for what, x, v in (("input and position", drive, speed), ("input and speed", position, drive)):
        if np.ptp(x) and _ratio(time, x, v)[1] > SURE:
            return f"{what} are swapped"
    return None


def _ratio(time: np.ndarray, position: np.ndarray, speed: np.ndarray) -> tuple[float, float]:
    """Return the slope of the travelled way against position, short-term, and its quality.

    Differences over a hundredth of the record, so that a drift of the integral and noise of
    the position matter little; none spans a gap.
    """
    steps = np.diff(time)
    whole = steps <= GAP * np.median(steps)
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * steps * whole)])
    stretch = np.concatenate([[0], np.cumsum(~whole)])
    lag = max(1, min(len(time) // 200, len(time) // (2 * int(stretch[-1] + 1))))
    inside = stretch[lag:] == stretch[:-lag]
    own, moved = (way[lag:] - way[:-lag])[inside], (position[lag:] - position[:-lag])[inside]
    power = float(moved @ moved)
    if power == 0.0:
        return math.nan, 0.0
    correlation = float(moved @ own) / math.sqrt(power * float(own @ own) or 1.0)
    return float(moved @ own) / power, abs(correlation)


def _check_wraps(record: RigRecord) -> None:
    """Refuse a position that jumps by always the same, nearly all of its travel."""
    position, time = record.channel(POSITION), record.time
    travel = float(np.ptp(position))
    steps = np.diff(position)
    usual = np.quantile(np.abs(steps), 0.95)
    near = np.diff(time) <= GAP * np.median(np.diff(time))
    rows = np.nonzero((np.abs(steps) > max(JUMP * travel, 5.0 * usual)) & near)[0]
    if not 2 <= len(rows) <= 0.2 * len(steps):
        return
    around = np.array([steps[np.maximum(rows - 1, 0)],
                       steps[np.minimum(rows + 1, len(steps) - 1)]])
    jumps = np.abs(steps[rows] - around.mean(axis=0))  # less what the axis moved meanwhile
    if np.mean(np.abs(around) > JUMP * travel) > BACK:
        return  # there and back again: spikes
    period = float(np.median(jumps))
    if np.mean(np.abs(jumps - period) > ALIKE * travel) > 0.1:
        return
    turn = record.axis.motion == "rotary" and abs(period / (2 * math.pi) - 1.0) < ALIKE
    raise InvalidRecordError(
        f"{record.source}: the position jumps {len(jumps)} times by {period:.4g} "
        f"{record.axis.position_unit}{' (a turn)' if turn else ''}: a counter that starts again: "
        "set 'unwrap:' of its column in the map to that period, in the unit of the column"
    )


def check_input(
    record: RigRecord, trajectory: Trajectory,
    prepared: Callable[[RigRecord], Trajectory | None],
) -> None:
    """Compare the input with what inertia, friction, a spring and a weight could need.

    Parameters
    ----------
    record : as recorded.
    trajectory : its motion.
    prepared : makes the trajectory of another record, None where it cannot be used.

    Raises
    ------
    InvalidRecordError
        The input is reversed, has lost its sign, is clipped, or is swapped with the motion.
    """
    taking, free = _needs(trajectory)
    target = trajectory.target
    as_is, turned = _left(taking, free, target), _left(taking, free, -target)
    source, name = record.source, record.axis.input
    if as_is > SOME and record.has(POSITION) != record.has(SPEED):
        other = prepared(replace(record, samples=record.samples[:, [0, 2, 1, *range(
            3, record.samples.shape[1])]]))
        if other is not None and _left(*_needs(other), other.target) < 0.1 * min(as_is, turned):
            motion = POSITION if record.has(POSITION) else SPEED
            raise InvalidRecordError(f"{source}: input and {motion} are swapped (exchanged, they "
                                     "agree): exchange their columns in the map")
    if turned < min(TURNED * as_is, 1.0 - LEAST):
        raise InvalidRecordError(
            f"{source}: the {name} is reversed: inertia and friction would give energy "
            f"({100 * (1 - turned):.0f} % of it is explained with the other sign, "
            f"{100 * (1 - as_is):.0f} % as it is): set 'scale: -1' of the input in the map")
    if as_is > LEAST and _has_lost_its_sign(record, trajectory, as_is):
        raise InvalidRecordError(
            f"{source}: the {name} has no sign (never below zero, though the motion reverses, and "
            "explained once it is given one): record it with its sign, or its two phases")
    for side, word in ((1.0, "above"), (-1.0, "below")):
        _check_clipped(record, trajectory, side, word)


def _needs(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return what takes energy or stores it by inertia, and what may have any sign; (rows, k)."""
    taking = trajectory.reduce(lambda s: np.column_stack(
        [s.acceleration, s.speed, np.sign(s.smooth_speed)]))
    rotary = trajectory.axis.motion == "rotary"
    free = trajectory.reduce(lambda s: np.column_stack([
        np.ones(len(s)), s.position - s.position.mean(), s.disturbance,
        *((np.cos(s.position), np.sin(s.position)) if rotary else ())]))
    return taking, free


def _left(taking: np.ndarray, free: np.ndarray, target: np.ndarray) -> float:
    """Return the share of squares, less the free columns, that is left without giving energy."""
    basis, size, _ = np.linalg.svd(free / np.maximum(np.abs(free).max(axis=0), 1e-300),
                                   full_matrices=False)
    basis = basis[:, size > 1e-8 * size[0]]
    rest = target - basis @ (basis.T @ target)
    columns = taking - basis @ (basis.T @ taking)
    columns /= np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    total = float(np.sum(rest**2))
    if total <= 1e-12 * float(np.sum(target**2)):
        return 0.0
    _, norm = optimize.nnls(columns, rest)
    return float(norm**2) / total


def _has_lost_its_sign(record: RigRecord, trajectory: Trajectory, as_is: float) -> bool:
    """Return whether the input is the size of one that a passive axis would need."""
    low, high = np.quantile(record.input, [0.005, 0.995])
    forward = float(np.mean(trajectory.speed > 0.0))
    if low < -0.03 * high or high <= 0.0 or not 0.1 < forward < 0.9:
        return False
    size = trajectory.pick(lambda s: low_pass(s.input, s.rate, trajectory.band))
    position = trajectory.position
    columns = np.column_stack([
        trajectory.acceleration, trajectory.speed, np.sign(trajectory.speed), np.ones(len(size)),
        position - position.mean(), *((np.cos(position), np.sin(position))
                                      if record.axis.motion == "rotary" else ())])
    columns /= np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    best = math.inf
    for start in columns.T:
        sign = np.sign(start)
        for _ in range(30):
            found, *_ = np.linalg.lstsq(columns, sign * size, rcond=1e-10)
            before, sign = sign, np.sign(columns @ found)
            if np.array_equal(before, sign):
                break
        best = min(best, float(np.sum((size - np.abs(columns @ found)) ** 2)))
    return best < RESTORED * as_is * float(np.sum((size - size.mean()) ** 2))


def _check_clipped(record: RigRecord, trajectory: Trajectory, side: float, word: str) -> None:
    """Refuse an input that stays at its extreme where the motion needs more than that.

    A drive that is at its limit gives what is recorded; a converter that is does not show it.
    """
    values = side * record.input
    most, span = float(values.max()), float(np.ptp(values))
    at = values >= most - 1e-9 * span
    below = np.count_nonzero((values >= most - 0.02 * span) & ~at)
    if at.mean() < FEW or at.sum() < PLATEAU * below or len(np.unique(values)) < 30:
        return
    limit, other = most - 1e-6 * span, most - (1.0 - 1e-6) * span
    ends = trajectory.reduce(lambda s: np.column_stack(
        [side * s.input >= limit, side * s.input <= other]).astype(np.float64))
    hit, clean = ends[:, 0] > 0.9, (ends < 0.02).all(axis=1)
    if clean.sum() < FIT_ROWS or hit.sum() < 5:
        return
    columns = np.column_stack(_needs(trajectory))
    columns /= np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    found, *_ = np.linalg.lstsq(columns[clean], trajectory.target[clean], rcond=1e-8)
    rest = trajectory.target - columns @ found
    excess = float(np.mean(-side * rest[hit]))
    if excess > max(2.0 * float(np.std(rest[clean])), 0.02 * span):
        unit = record.axis.input_channel.unit
        raise InvalidRecordError(
            f"{record.source}: the {record.axis.input} is clipped at {side * most:.4g} {unit} for "
            f"{100 * at.mean():.0f} % of the samples (the motion needs {excess:.3g} {unit} {word} "
            "that on average): record it with a wider range, or import a part without it by "
            "'start' and 'end'")
