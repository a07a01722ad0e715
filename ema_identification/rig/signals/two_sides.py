"""Motor side and output side measured both: the lost motion and the wind-up between them, seen."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

from ema_identification.report.words import number
from ema_identification.result import INTERVAL_LEVEL
from ema_identification.rig.signals.trajectory import derivative, low_pass
from ema_rig.record import OUTPUT_POSITION, POSITION

MOVING = 0.1
"""Share of the rms speed above which the axis moves."""
BLOCKS = 12
FOLLOWS = 0.9
"""Least correlation of the two positions."""

Interval = tuple[float, float, float]
"""Value, and the ends of its interval of `INTERVAL_LEVEL`."""


def lost_and_wound(pieces: Sequence[dict[str, np.ndarray]], band: float) -> \
        tuple[Interval, Interval] | str:
    """Return lost motion and wind-up between `position` and `output_position`, or why not.

    While the axis moves, their difference is d = d_0 + (b / 2) sign(v) + c a: b is the backlash
    with the wind-up of the output's dry friction, c = J_l / k the wind-up by its inertia.

    Parameters
    ----------
    pieces : stretches of a record, evenly sampled, with ``rate`` (1/s).
    band : cut-off below which the motion stands above its noise (Hz).
    """
    rows: list[np.ndarray] = []
    for piece in pieces:
        rate = float(piece["rate"])
        speed = derivative(low_pass(piece[POSITION], rate, band), 1.0 / rate)
        rows.append(np.column_stack([
            piece[POSITION] - piece[OUTPUT_POSITION], np.sign(speed),
            derivative(speed, 1.0 / rate), speed, piece[POSITION], piece[OUTPUT_POSITION]]))
    data = np.concatenate(rows)
    alike = float(np.corrcoef(data[:, 4], data[:, 5])[0, 1])
    if not alike > FOLLOWS:
        return (f"output_position does not follow position (correlation {alike:.2f}): check its "
                "scale, which is the ratio of the gear, and its sign")
    ratio = float(np.polyfit(data[:, 4], data[:, 5], 1)[0])
    if abs(ratio - 1.0) > 0.01:
        return (f"output_position moves {ratio:.4g} times as far as position: correct its scale, "
                "the ratio of the gear")
    data = data[np.abs(data[:, 3]) > MOVING * np.sqrt(np.mean(data[:, 3] ** 2))]
    found = []
    for block in np.array_split(data, BLOCKS):
        columns = np.column_stack([np.ones(len(block)), 0.5 * block[:, 1], block[:, 2]])
        fitted, _, rank, _ = np.linalg.lstsq(columns, block[:, 0], rcond=1e-9)
        if rank == 3:
            found.append(fitted[1:])
    if len(found) < BLOCKS // 2:
        return "between the sides: too few reversals to see the lost motion"
    values = np.array(found)
    wide = stats.t.ppf(0.5 + 0.5 * INTERVAL_LEVEL, len(values) - 1) * values.std(
        axis=0, ddof=1) / math.sqrt(len(values))
    first, second = (
        (float(value), float(value - half), float(value + half))
        for value, half in zip(values.mean(axis=0), wide))
    return first, second


def between_the_sides(pieces: Sequence[dict[str, np.ndarray]], band: float, unit: str) -> str:
    """Return what lies between the two sides in words; `unit` is that of the positions."""
    found = lost_and_wound(pieces, band)
    if isinstance(found, str):
        return found
    lost, wound = (f"{number(value)} {of} (90 %: {number(low)} to {number(high)})"
                   for (value, low, high), of in zip(found, (unit, "s²")))
    return (f"between position and output_position: lost motion {lost}, backlash with the "
            f"wind-up of dry friction behind it; wind-up by acceleration {wound}")
