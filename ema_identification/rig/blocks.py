"""Blocks of time: what is held out together, and what changes its sign together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_identification.rig.trajectory import Trajectory

FEWEST, MOST = 12, 60
CORRELATION_TIMES = 6.0
"""A block lasts so many correlation times of the residual at least."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Blocks:
    """The block of each row, numbered from 0 without a hole."""

    of_row: np.ndarray
    """Shape (rows,), integers that do not fall."""
    count: int
    length: float
    """Time of a block, without what is left out (s)."""

    @property
    def starts(self) -> np.ndarray:
        """First row of each block, shape (count,)."""
        return np.searchsorted(self.of_row, np.arange(self.count))

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Return the sums of rows within each block, shape (count, ...)."""
        total: np.ndarray = np.add.reduceat(values, self.starts, axis=0)
        return total


def make_blocks(trajectory: Trajectory, residual: np.ndarray) -> Blocks:
    """Return blocks long enough that their residuals are independent.

    Parameters
    ----------
    trajectory : Trajectory
        Whose rows are divided; a block never spans a gap.
    residual : ndarray, shape (rows,)
        Of the freest model, so that what is left is noise.

    """
    duration = len(residual) / trajectory.row_rate
    wanted = CORRELATION_TIMES * correlation_time(residual, trajectory.row_rate)
    count = int(np.clip(duration / max(wanted, 1e-12), FEWEST, MOST))
    size = len(residual) / count
    first = np.searchsorted(trajectory.segment_of_row, trajectory.segment_of_row)
    within = (np.arange(len(residual)) - first) / size
    key = trajectory.segment_of_row * 1_000_000 + within.astype(np.int64)
    _, of_row = np.unique(key, return_inverse=True)
    of_row = _merged(of_row)
    return Blocks(of_row=of_row, count=int(of_row[-1]) + 1, length=duration / count)


def _merged(of_row: np.ndarray) -> np.ndarray:
    """Join blocks of very few rows (at the ends of a segment) to the one before."""
    sizes = np.bincount(of_row)
    least = 0.2 * float(np.median(sizes))
    new = np.cumsum(sizes >= least) - 1
    numbered: np.ndarray = np.maximum(new, 0)[of_row]
    return numbered


def correlation_time(residual: np.ndarray, rate: float) -> float:
    """Return the integral correlation time of a residual (s), by its autocorrelation."""
    centred = residual - residual.mean()
    size = 1 << int(np.ceil(np.log2(2 * len(centred))))
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    correlation = np.fft.irfft(spectrum)[: len(centred) // 4]
    if correlation[0] <= 0.0:
        return 1.0 / rate
    correlation = correlation / correlation[0]
    below = np.nonzero(correlation < 0.05)[0]
    end = int(below[0]) if len(below) else len(correlation)
    return float((0.5 + correlation[1:end].sum()) / rate)
