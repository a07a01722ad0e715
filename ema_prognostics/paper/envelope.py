"""Envelope of the two-phase-on portions: maximum, mean, and its symmetry (section V.B)."""

from __future__ import annotations

import numpy as np

from ema_prognostics.features.turns import TURN, Turns
from ema_record.channels import REFERENCE_CURRENTS

BINS = 72
"""Bins of a folded turn, 5° each."""


def fold(turns: Turns, signal: np.ndarray, bins: int = BINS) -> np.ndarray:
    """Return the mean of `signal`, shape (n,), in each bin of a turn, shape (bins,).

    A bin that holds no sample takes the mean of its neighbours by interpolation.
    """
    index = np.floor(np.mod(turns.theta, TURN) * (bins / TURN)).astype(int) % bins
    weight = np.bincount(index, turns.weight, bins)
    total = np.bincount(index, turns.weight * signal, bins)
    full = weight > 0.0
    mean = np.divide(total, weight, out=np.zeros(bins), where=full)
    if not full.all():
        at = np.flatnonzero(full)
        mean = np.interp(np.arange(bins), at, mean[at], period=bins)
    return mean


def envelopes(turns: Turns) -> tuple[np.ndarray, np.ndarray]:
    """Return the folded upper and lower envelope of the reference currents, shape (72,) (A)."""
    current = turns.samples[:, REFERENCE_CURRENTS]
    return fold(turns, current.max(axis=1)), fold(turns, current.min(axis=1))


def symmetry(upper: np.ndarray, lower: np.ndarray) -> float:
    """Return how the negative portions relate to the positive ones, -1 to 1.

    The correlation of the upper envelope with the lower envelope half a turn later: the
    negative portion of the same phase. -1: symmetric to the horizontal axis; +1: shifted.

    Parameters
    ----------
    upper, lower : ndarray, shape (bins,). From `envelopes` (A).
    """
    later = np.roll(lower, -len(lower) // 2)
    a, b = upper - upper.mean(), later - later.mean()
    norm = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / norm if norm > 0.0 else 0.0
