"""Least squares within bounds, residuals of held-out blocks of time, and honest covariance.

A block is held out, and changes its sign, together: its residuals are correlated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, signal, stats

from ema_identification.result import INTERVAL_LEVEL
from ema_identification.rig.signals.trajectory import Trajectory

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
        return np.asarray(np.add.reduceat(values, self.starts, axis=0))


def make_blocks(trajectory: Trajectory, residual: np.ndarray) -> Blocks:
    """Return blocks long enough that their residuals are independent.

    Parameters
    ----------
    trajectory : whose rows are divided; a block never spans a gap.
    residual : ndarray, shape (rows,). Of the freest model, so that what is left is noise.
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
    return np.asarray(np.maximum(np.cumsum(sizes >= least) - 1, 0)[of_row])


def autocorrelation(values: np.ndarray, lags: int) -> np.ndarray:
    """Return the sums of products of values less their mean at lags 0 to `lags` - 1."""
    centred = values - values.mean()
    return np.asarray(signal.correlate(centred, centred, method="fft")[len(values) - 1:][:lags])


def correlation_time(residual: np.ndarray, rate: float) -> float:
    """Return the integral correlation time of a residual (s), by its autocorrelation."""
    correlation = autocorrelation(residual, len(residual) // 4)
    if correlation[0] <= 0.0:
        return 1.0 / rate
    correlation = correlation / correlation[0]
    below = np.nonzero(correlation < 0.05)[0]
    end = int(below[0]) if len(below) else len(correlation)
    return float((0.5 + correlation[1:end].sum()) / rate)


RANK = 1e-9
"""Directions below this share of the largest are left out of a solution."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoefficientBounds:
    """Bounds of the coefficients, shape (columns,) each; infinite where free."""

    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearFit:
    """Coefficients of a linear model within bounds."""

    coefficients: np.ndarray
    residual: np.ndarray
    active: np.ndarray
    """Whether each coefficient stands at a bound, shape (columns,) of bool."""


def solve_normal_equations(gram: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """Return the solution of normal equations, columns scaled, weak directions left out."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    solution, *_ = np.linalg.lstsq(
        gram / np.outer(scale, scale), moment / scale, rcond=RANK)
    return np.asarray(solution / scale)


def fit(
    columns: np.ndarray, target: np.ndarray, bounds: CoefficientBounds | None = None
) -> LinearFit:
    """Return the least-squares fit of `target` by `columns`, within bounds.

    Parameters
    ----------
    columns : ndarray, shape (rows, p). Regressors.
    target : ndarray, shape (rows,). Input.
    bounds : of the coefficients.
    """
    count = columns.shape[1]
    if count == 0:
        return LinearFit(coefficients=np.empty(0), residual=target.copy(),
                         active=np.empty(0, bool))
    scale = np.sqrt(np.mean(columns**2, axis=0))
    scale[scale == 0.0] = 1.0
    free, *_ = np.linalg.lstsq(columns / scale, target, rcond=1e-10)
    coefficients = free / scale
    active = np.zeros(count, dtype=bool)
    if bounds is not None and bool(
        ((coefficients < bounds.low) | (coefficients > bounds.high)).any()
    ):
        compressed, triangle = np.linalg.qr(columns / scale)
        found = optimize.lsq_linear(
            triangle, compressed.T @ target,
            bounds=(bounds.low * scale - 1e-12, bounds.high * scale + 1e-12))
        coefficients = np.clip(found.x / scale, bounds.low, bounds.high)
        active = found.active_mask != 0
    return LinearFit(coefficients=coefficients, residual=target - columns @ coefficients,
                     active=active)


def held_out(columns: np.ndarray, target: np.ndarray, blocks: Blocks) -> np.ndarray:
    """Return the residual of each row under the fit of all other blocks, shape (rows,)."""
    if columns.shape[1] == 0:
        return target.copy()
    residual = np.empty_like(target)
    starts = [*blocks.starts.tolist(), len(target)]
    spans = [slice(a, b) for a, b in zip(starts[:-1], starts[1:])]
    grams = [columns[s].T @ columns[s] for s in spans]
    moments = [columns[s].T @ target[s] for s in spans]
    gram, moment = np.sum(grams, axis=0), np.sum(moments, axis=0)
    for span, own_gram, own_moment in zip(spans, grams, moments):
        coefficients = solve_normal_equations(gram - own_gram, moment - own_moment)
        residual[span] = target[span] - columns[span] @ coefficients
    return residual


def covariance(columns: np.ndarray, residual: np.ndarray, blocks: Blocks) -> np.ndarray:
    """Return the covariance of coefficients, with residuals correlated within blocks, (p, p).

    The jackknife over blocks: the sandwich of Liang and Zeger (Biometrika 73(1), 1986) with
    the correction for few blocks that is known as CR3.
    """
    count = columns.shape[1]
    starts = [*blocks.starts.tolist(), len(residual)]
    gram = columns.T @ columns
    spread = np.zeros((count, count))
    for first, last in zip(starts[:-1], starts[1:]):
        own = columns[first:last]
        moment = own.T @ residual[first:last]
        left = solve_normal_equations(gram - own.T @ own, moment)
        spread += np.outer(left, left)
    return (blocks.count - 1) / blocks.count * spread


def half_width(variance: float, blocks: Blocks) -> float:
    """Return half the interval of `INTERVAL_LEVEL` for a coefficient of that variance."""
    quantile = float(stats.t.ppf(0.5 + INTERVAL_LEVEL / 2, max(blocks.count - 1, 1)))
    return quantile * float(np.sqrt(max(variance, 0.0)))
