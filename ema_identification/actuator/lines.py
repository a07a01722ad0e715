"""Complex lines of signals against the rotor angle, seen through a Hann window in angle.

The window keeps drift and decaying transients out of the lines, so that these do not depend on
the angle at which a segment happens to begin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

TURN = 2.0 * np.pi
BINS = 2048
"""Angles are rounded to this part of a turn; line 64 loses 0.2 % by it."""
FEWEST = 40
"""Fewest samples for lines."""


class Turns(NamedTuple):
    """Samples of whole turns (of all, if there are fewer than two), and their weights."""

    part: slice
    theta: np.ndarray
    """rad, unwrapped."""
    share: np.ndarray
    """Of the angle; sums to 1."""
    window: np.ndarray
    """Hann in angle times share; sums to 1."""


def turns_of(theta: np.ndarray, part: slice) -> Turns | None:
    """Return the last whole turns of `part`, or all of it below two; None if it hardly moves."""
    angle = theta[part]
    if len(angle) < FEWEST:
        return None
    travel = float(angle[-1] - angle[0])
    if abs(travel) < 0.8 * TURN or len(angle) < 16 * abs(travel) / TURN:
        return None
    sense = np.sign(travel)
    if abs(travel) >= 2.0 * TURN:
        begin = angle[-1] - sense * TURN * int(abs(travel) / TURN)
        first = int(np.argmax(sense * (angle - begin) >= 0.0))
        part = slice(part.start + first, part.stop)
        angle = angle[first:]
        travel = float(angle[-1] - angle[0])
    edges = np.empty(len(angle) + 1)
    edges[1:-1] = 0.5 * (angle[1:] + angle[:-1])
    edges[0], edges[-1] = angle[0], angle[-1]
    share = np.diff(edges) / travel
    window = share * (1.0 - np.cos(TURN * (angle - angle[0]) / travel))
    return Turns(part, angle, share, window / window.sum())


def lines(turns: Turns, signals: np.ndarray, highest: int) -> np.ndarray:
    """Return the weighted means of x e^{-jhθ}, shape (highest + 1, m), complex.

    Line 0 is the mean over the angle; the others are of the signal without mean and slope.

    Parameters
    ----------
    turns : the turns.
    signals : ndarray, shape (n, m), real, of the samples of the turns.
    highest : h runs from 0 to it.
    """
    mean = turns.share @ signals
    centre = turns.window @ turns.theta
    arm = turns.theta - centre
    slope = (turns.window * arm) @ signals / ((turns.window * arm) @ arm)
    level = turns.window @ signals
    bins = np.floor(turns.theta * (BINS / TURN) + 0.5).astype(np.int64) % BINS
    folded = _folded(signals, bins, level, slope, arm, turns.window)
    found = np.fft.rfft(folded, axis=0)[:highest + 1]
    found[0] = mean
    return np.asarray(found)


@njit(cache=True, nogil=True)
def _folded(
    signals: np.ndarray, bins: np.ndarray, level: np.ndarray, slope: np.ndarray, arm: np.ndarray,
    window: np.ndarray,
) -> np.ndarray:
    """Return the weighted signals, without mean and slope, summed in bins, shape (BINS, m)."""
    found = np.zeros((BINS, signals.shape[1]))
    for i in range(signals.shape[0]):
        for m in range(signals.shape[1]):
            found[bins[i], m] += (signals[i, m] - level[m] - slope[m] * arm[i]) * window[i]
    return found
