"""Clocks of the outputs: a speed that lags behind the position, as a drive's filter makes it.

A drive estimates its speed from its encoder and filters it; the record then holds a position
and a speed of different times. Friction and ripple would be evaluated at one of them and the
inertia at the other, and what is left between looks like an effect of the axis.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import interpolate

from ema_identification.rig.trajectory import derivative, low_pass
from ema_record.rig import POSITION, SPEED

PARTS = 20
"""Pieces of time whose lags are compared for the error of their mean."""
SURE = 4.0
"""Standard errors by which a lag must differ from none."""
LEAST = 0.05
"""Sampling intervals; a smaller lag is left."""
MOST = 0.25
"""Largest lag, in periods of the motion: more is no filter's."""
ITERATIONS = 4

Piece = dict[str, np.ndarray]
"""Columns by name on an even grid, with ``time`` and ``rate``."""


def speed_lag(pieces: Sequence[Piece], band: float, motion: float) -> float:
    """Return by how much the recorded speed lags behind the recorded position (s).

    Parameters
    ----------
    pieces : sequence of dict of ndarray
        Stretches without a gap, with position and speed.
    band : float
        Where both are looked at (Hz).
    motion : float
        Frequency below which the power of the speed lies (Hz).

    Returns
    -------
    float
        Zero where the lag is not clear, below `LEAST` intervals or beyond `MOST` periods.

    """
    rate = float(pieces[0]["rate"])
    total = 0.0
    for _ in range(ITERATIONS):
        change, error = _step(pieces, band, total)
        total += change
        if abs(total) * motion > MOST:
            return 0.0
        if abs(change) < 0.01 / rate:
            break
    return total if abs(total) > max(SURE * error, LEAST / rate) else 0.0


def _step(pieces: Sequence[Piece], band: float, lag: float) -> tuple[float, float]:
    """Return the lag beside `lag` and its standard error, by the slope of the speed (s)."""
    products: list[float] = []
    squares: list[float] = []
    for piece in pieces:
        rate = float(piece["rate"])
        speed = low_pass(earlier(piece[SPEED], piece["time"], lag), rate, band)
        true = low_pass(derivative(piece[POSITION], 1.0 / rate), rate, band)
        slope = derivative(speed, 1.0 / rate)
        edge = min(int(2.0 * rate / band), len(speed) // 4)
        inside = slice(edge, len(speed) - edge)
        parts = max(2, round(PARTS * len(speed) / sum(len(p["time"]) for p in pieces)))
        for own, rest in zip(np.array_split(slope[inside], parts),
                             np.array_split((true - speed)[inside], parts)):
            products.append(float(own @ rest))
            squares.append(float(own @ own))
    power = sum(squares)
    if power <= 0.0:
        return 0.0, np.inf
    mean = sum(products) / power
    spread = np.array(products) - mean * np.array(squares)
    return mean, float(np.sqrt(np.sum(spread**2)) / power)


def earlier(values: np.ndarray, time: np.ndarray, lag: float) -> np.ndarray:
    """Return values as they were `lag` (s) later, so that a lag is taken out, shape (n,)."""
    if lag == 0.0:
        return values
    shifted: np.ndarray = interpolate.CubicSpline(time, values)(
        np.clip(time + lag, time[0], time[-1]))
    return shifted
