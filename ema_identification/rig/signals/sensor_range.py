"""A position that stays at the end of its sensor's range while the axis goes on.

Mass makes the speed continuous: a stop may end a motion at once, but an axis leaves a rest no
sharper than its drive bends the motion elsewhere (Newton's second law). A sensor at its limit is
left at the speed that the axis has by then, and nothing pushes it to that. Whether the sharpest
bends of a record are those after such stays by chance is told by their ranks (Lehmann 1975,
Nonparametrics, ch. 1).
"""

from __future__ import annotations

import numpy as np

from ema_record.errors import InvalidRecordError, counted
from ema_rig.record import POSITION, SPEED, RigRecord

LEAST_STAY = 3
"""Samples at an extreme that make a stay: two may be a reversal between them."""
LAGS = (1, 2, 4, 8, 16)
"""Samples to either side over which a bend is seen; short ones are sharp, and in long ones the
steps of a converter matter less. All are looks, and counted as such."""
PUSHED = 0.5
"""Midway between no push and the whole one that a bend needs: the likelier of the two."""


def check_range(record: RigRecord, level: float) -> None:
    """Refuse a position that is clipped, at a level of chance.

    Raises
    ------
    InvalidRecordError
        Where the position leaves one of its extremes, at which it stayed without any change, it
        bends more sharply than anywhere else, and the input does not push it.
    """
    position = record.channel(POSITION)
    stays = {side: _stays(side * position) for side in (1.0, -1.0)}
    every = np.concatenate(list(stays.values()))
    for side, own in stays.items():
        if not any(_leaves_at_speed(position, record.input, own, every, lag, level)
                   for lag in LAGS):
            continue
        most, unit = side * (side * position).max(), record.axis.position_unit
        share = float(np.mean(position == most))
        other = "leave it out of the map, as the speed is there, " if record.has(SPEED) else ""
        raise InvalidRecordError(
            f"{record.source}: the position is clipped at {most:.5g} {unit} for {100 * share:.0f} "
            f"% of the samples ({counted(len(own), 'stay')}, left at speed without a push): "
            f"{other}record less travel or with a wider range of the sensor, or import a part "
            "without it by 'start' and 'end'")


def _stays(values: np.ndarray) -> np.ndarray:
    """Return the first sample of each stay at the maximum and the first after it, shape (k, 2)."""
    edges = np.diff(np.r_[0, (values == values.max()).astype(np.int8), 0])
    found = np.column_stack([np.nonzero(edges == 1)[0], np.nonzero(edges == -1)[0]])
    return found[found[:, 1] - found[:, 0] >= LEAST_STAY]


def _leaves_at_speed(
    position: np.ndarray, drive: np.ndarray, own: np.ndarray, stays: np.ndarray, lag: int,
    level: float,
) -> bool:
    """Return whether stays end at a speed that the axis was not pushed to.

    Parameters
    ----------
    position, drive : ndarray, shape (n,). As recorded.
    own, stays : ndarray of int, shape (k, 2). At one extreme and at both: first sample, first one
        after it.
    lag : samples to either side over which a bend is seen.
    level : of all looks together.
    """
    own = own[(own[:, 1] - own[:, 0] >= lag) & (own[:, 1] + lag < len(position))]
    if not len(own):
        return False
    middle = np.arange(lag, len(position) - lag)
    bend = position[middle + lag] - 2.0 * position[middle] + position[middle - lag]
    elsewhere = np.ones(len(position), dtype=bool)
    apart = elsewhere.copy()
    for first, after in stays:  # how a stay begins may be a stop's doing; one ends between two
        elsewhere[max(first - lag, 0):after + 1] = False
        apart[max(first - lag, 0):after + lag] = False
    elsewhere, apart, ends = elsewhere[middle], apart[middle], own[:, 1] - 1 - lag
    sharp = ends[np.abs(bend[ends]) > np.abs(bend[elsewhere]).max(initial=0.0)]
    ranks = np.arange(len(sharp))
    others = np.count_nonzero(elsewhere) // (2 * lag + 1)  # bends that share no sample
    chance = np.prod((len(ends) - ranks) / (others + len(ends) - ranks))
    if chance * 2 * len(LAGS) > level or np.count_nonzero(apart) < 2 * lag + 1:
        return False
    # A bend is the sum of the accelerations between, weighted by a triangle; so is what drives it.
    push = np.convolve(drive, lag - np.abs(np.arange(1 - lag, lag)), mode="valid")
    push = push[(len(push) - len(middle)) // 2:][:len(middle)]
    way = position[middle + lag] - position[middle - lag]
    columns = np.column_stack([bend, way, np.sign(way), np.ones(len(middle))])
    found, *_ = np.linalg.lstsq(columns[apart], push[apart], rcond=1e-10)
    shown = np.sum((push[sharp] - columns[sharp, 1:] @ found[1:]) * bend[sharp])
    return bool(found[0] > 0.0 and shown < PUSHED * found[0] * np.sum(bend[sharp] ** 2))
