"""How fast a fault grows over flights; when it reaches a level, see `forecast`.

The rate is the median of the slopes of all pairs of flights, which one flight in four may
spoil; whether it is growth at all is decided by Kendall's rank test.

Sources: P. K. Sen, J. Am. Stat. Assoc. 63 (1968) 1379; M. G. Kendall, Biometrika 30 (1938) 81.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

MIN_FLIGHTS = 5
"""Flights with a severity below which no rate is given."""
INTERVAL = 0.90
"""Coverage of all intervals here, and of the verdicts' severity intervals."""
SIGNIFICANCE = 0.05
QUANTILE = float(ndtri(0.5 + 0.5 * INTERVAL))


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """Growth of one severity, in its unit a flight.

    Attributes
    ----------
    count : flights that it is taken from.
    rate, rate_interval : median of the slopes of pairs, with its 90 % interval.
    p_value : of Kendall's test against no growth, one-sided.
    growing : the rate's interval lies above 0 and the test rejects.
    severity : now, of the last few flights together.
    severity_error : its standard error.
    wander : variance that a flight adds beyond the steady rate (bursts, plateaus).
    """

    count: int
    rate: float
    rate_interval: tuple[float, float]
    p_value: float
    growing: bool
    severity: float
    severity_error: float
    wander: float


def growth(
    number: np.ndarray, severity: np.ndarray, lower: np.ndarray, upper: np.ndarray,
    significance: float = SIGNIFICANCE,
) -> Growth | None:
    """Return the growth of a severity, or None with less than `MIN_FLIGHTS` flights.

    Parameters
    ----------
    number : ndarray, shape (n,). Numbers of the flights, increasing.
    severity, lower, upper : ndarray, shape (n,). With its 90 % interval.
    significance : highest p-value of the rank test that is called growth.
    """
    from scipy.stats import kendalltau, theilslopes

    count = len(number)
    if count < MIN_FLIGHTS:
        return None
    x, y = number.astype(float), severity.astype(float)
    slopes = theilslopes(y, x, alpha=INTERVAL)
    rate = float(slopes.slope)
    p_value = 1.0
    if np.ptp(y) > 0.0:
        p_value = float(kendalltau(x, y, alternative="greater").pvalue)
    noise = _noise(y, 0.5 * (upper - lower) / QUANTILE)
    wander = _wander(x, y, rate, noise)
    span = float(x[-1] - x[0])
    # Sen's interval knows of no bursts; the other one of nothing but two ends and wander.
    error = np.sqrt(wander / span + 2.0 * noise**2 / (span**2 * max(1.0, count / 6.0)))
    interval = (float(min(slopes.low_slope, rate - QUANTILE * error)),
                float(max(slopes.high_slope, rate + QUANTILE * error)))
    last = slice(-min(5, count), None)
    now = float(np.median(y[last] + rate * (x[-1] - x[last])))
    return Growth(
        count=count, rate=rate, rate_interval=interval, p_value=p_value,
        growing=bool(p_value < significance and interval[0] > 0.0), severity=now,
        severity_error=float(noise * np.sqrt(0.5 * np.pi / min(5, count))), wander=wander,
    )


def _noise(y: np.ndarray, sigma: np.ndarray) -> float:
    """Return the scatter of one severity: that of the intervals, or less if the data show less.

    An interval also holds the error that all flights of a unit share.
    """
    stated = float(np.sqrt(np.mean(sigma**2)))
    seen = float(np.sqrt(0.5 * np.mean(np.diff(y) ** 2)))
    return min(stated, seen)


def _wander(x: np.ndarray, y: np.ndarray, rate: float, noise: float) -> float:
    """Return the variance a flight that the steady rate and the scatter leave unexplained."""
    lag = max(1, len(y) // 5)
    dx, dy = x[lag:] - x[:-lag], y[lag:] - y[:-lag]
    return float(max(0.0, np.mean((dy - rate * dx) ** 2) - 2.0 * noise**2) / np.mean(dx))
