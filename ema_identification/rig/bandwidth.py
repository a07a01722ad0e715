"""How wide the measured response is: the band within which it stands above its noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

RATIO = 10.0
"""Power of the response over that of its noise at the edge of the band."""
HARMONICS = 5.0
"""The band holds so many harmonics of the motion, whatever the noise."""
WIDEST = 0.2
"""Widest band, in units of the sampling rate."""


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
    values : ndarray, shape (n,)
        Position, or speed where that is measured; evenly sampled.
    rate : float
        Samples a second (1/s).
    is_position : bool
        Whether `values` are positions.

    Returns
    -------
    Band
        The density of the noise is the median of the density between 0.3 and 0.45 of the
        rate; the edge is where the median density of a narrow bin last exceeds it tenfold.

    """
    length = min(len(values), max(256, min(len(values) // 4, 8192)))
    frequency, density = signal.welch(
        signal.detrend(values), rate, nperseg=length
    )
    top = (frequency > 0.3 * rate) & (frequency < 0.45 * rate)
    noise = float(np.median(density[top])) if top.any() else 0.0
    above = np.maximum(density - noise, 0.0)
    weight = (2 * np.pi * frequency) ** 2 if is_position else np.ones_like(frequency)
    power = np.cumsum(above * weight)
    motion = float(frequency[np.searchsorted(power, 0.99 * power[-1])]) if power[-1] > 0 else 0.0
    edges = np.geomspace(frequency[1], 0.45 * rate, 60)
    edge = 0.0
    for low, high in zip(edges[:-1], edges[1:]):
        inside = density[(frequency >= low) & (frequency < high)]
        if len(inside) and np.median(inside) > RATIO * noise:
            edge = float(high)
    edge = max(edge, HARMONICS * motion, 10.0 * rate / len(values))
    return Band(edge=min(edge, WIDEST * rate), noise_density=noise, motion=motion)


def speed_noise(band: Band, *, is_position: bool) -> float:
    """Return the noise of the speed within the band, rms."""
    if not is_position:
        return float(np.sqrt(band.noise_density * band.edge))
    return float(np.sqrt(band.noise_density * (2 * np.pi) ** 2 * band.edge**3 / 3.0))
