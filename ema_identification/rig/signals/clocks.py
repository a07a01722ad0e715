"""The band within which a response stands above its noise, and shifts between the outputs.

A drive estimates its speed from its encoder and filters it; the record then holds a position
and a speed of different times. Friction and ripple would be evaluated at one of them and the
inertia at the other, and what is left between looks like an effect of the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import interpolate, signal

from ema_identification.rig.signals.trajectory import derivative, low_pass
from ema_rig.record import POSITION, SPEED

RATIO = 10.0
"""Power of the response over that of its noise at the edge of the band."""
HARMONICS = 5.0
"""The band holds so many harmonics of the motion, whatever the noise."""
WIDEST = 0.2
"""Widest band, in units of the sampling rate."""
BINS = 60
"""Of equal width in log frequency, in which densities are looked at by their median."""
ATTENUATION = 1e-3
"""Largest share of noise in the power of the acceleration, by which an inertia is too small, for
a band that is wider than the response; noise of a converter is redder than taken here."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """Edge of the response, and the noise of what it was seen in."""

    edge: float
    """(Hz)"""
    noise_density: float
    """Power density of the noise of the output (its unit squared a Hz)."""
    motion: float
    """Frequency below which 99 % of the power of the speed lies (Hz)."""


def response_band(values: np.ndarray, rate: float, *, is_position: bool) -> Band:
    """Return the band of a measured output.

    Parameters
    ----------
    values : ndarray, shape (n,). Position, or speed where that is measured; evenly sampled.
    rate : samples a second (1/s).
    is_position : whether `values` are positions.

    Returns
    -------
    Band
        The density of the noise is the median of the density between 0.3 and 0.45 of the
        rate; the edge is where the median density of a narrow bin last exceeds it tenfold,
        or where the harmonics of the motion end, if the noise of the acceleration is small
        to there.
    """
    length = min(len(values), max(256, min(len(values) // 4, 8192)))
    frequency, density = signal.welch(
        signal.detrend(values), rate, nperseg=length
    )
    top = (frequency > 0.3 * rate) & (frequency < 0.45 * rate)
    noise = float(np.median(density[top])) if top.any() else 0.0
    edges = np.geomspace(frequency[1], 0.45 * rate, BINS)
    edge = 0.0
    for low, high in zip(edges[:-1], edges[1:]):
        inside = density[(frequency >= low) & (frequency < high)]
        if len(inside) and np.median(inside) > RATIO * noise:
            edge = float(high)
    order = 2 if is_position else 1
    motion = _motion(frequency, density, noise, edge, order - 1)
    hard = (2 * np.pi * frequency) ** (2 * order)
    lively = np.sum(np.maximum(density - noise, 0.0) * hard * (frequency <= edge))
    quiet = float(frequency[np.cumsum(noise * hard) <= ATTENUATION * lively][-1])
    harmonics = min(HARMONICS * motion, max(motion, quiet))
    edge = max(edge, harmonics, 10.0 * rate / len(values))
    return Band(edge=min(edge, WIDEST * rate), noise_density=noise, motion=motion)


def _motion(
    frequency: np.ndarray, density: np.ndarray, noise: float, edge: float, order: int
) -> float:
    """Return the frequency below which 99 % of the power of the speed lies (Hz).

    Looked for inside the response only: noise of a converter is not white, and what is left
    of it above, differentiated `order` times, is larger than the motion.
    """
    weight = (2 * np.pi * frequency) ** (2 * order) * (frequency <= edge)
    power = np.cumsum(np.maximum(density - noise, 0.0) * weight)
    if power[-1] <= 0.0:
        return 0.0
    return float(frequency[np.searchsorted(power, 0.99 * power[-1])])


def speed_noise(band: Band, *, is_position: bool) -> float:
    """Return the noise of the speed within the band, rms."""
    if not is_position:
        return float(np.sqrt(band.noise_density * band.edge))
    return float(np.sqrt(band.noise_density * (2 * np.pi) ** 2 * band.edge**3 / 3.0))


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
    pieces : sequence of dict of ndarray. Stretches without a gap, with position and speed.
    band : where both are looked at (Hz).
    motion : frequency below which the power of the speed lies (Hz).

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
    return np.asarray(interpolate.CubicSpline(time, values)(
        np.clip(time + lag, time[0], time[-1])))
