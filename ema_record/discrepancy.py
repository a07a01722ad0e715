"""What healthy machines leave over their best model, feature by feature: the discrepancy.

Its mean over units is measured with an error, the spread between units over the root of their
number; what is not larger than that error is no discrepancy. So each mean is shrunk by
1 − error² / mean², not below 0 (the positive part of James and Stein 1961), and its error is
part of the spread. Where units differ more than the model's do, so is the rest of their variance;
of few units it is known but badly, and a hundred features together tell how badly (`moderated`).
"""

from __future__ import annotations

import numpy as np

LEAST_RATIO, LEAST_FEATURES, MOST_FREEDOM = 1e-6, 10, 1e4
"""Variance ratio of a feature that differs at all; fewest of these that tell a prior; its degrees
of freedom from which all variances are as good as equal."""


def left_over(
    off: np.ndarray, units: np.ndarray, spread: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and spread of what the units of a type leave over the model, shapes (d,).

    Parameters
    ----------
    off : ndarray, shape (n, d). Measured features less the model's.
    units : ndarray, shape (n,). Unit of each.
    spread : ndarray, shape (d,). Standard deviation that the model itself gives to units.
    """
    means = np.array([off[units == unit].mean(axis=0) for unit in np.unique(units)])
    n = len(means)
    left = means.mean(axis=0)
    own = spread
    if n > 1:
        own = spread * np.sqrt(moderated((means.std(axis=0, ddof=1) / spread)**2, n - 1))
    error = np.maximum(own, spread) / np.sqrt(n)
    share = np.clip(1.0 - error**2 / np.maximum(left**2, 1e-30), 0.0, 1.0)
    more = np.maximum(own**2 - spread**2, 0.0)
    return share * left, np.sqrt(share * error**2 + more)


def moderated(ratio: np.ndarray, freedom: int) -> np.ndarray:
    """Return variance ratios of many features, each of few degrees of freedom, drawn together.

    Empirical Bayes with a scaled inverse chi-square prior, whose scale and degrees of freedom
    fit the logarithms of all (Smyth 2004, section 6.2).

    Parameters
    ----------
    ratio : ndarray, shape (d,). Measured, not negative.
    freedom : of each.
    """
    from scipy.optimize import brentq
    from scipy.special import digamma, polygamma

    known = ratio > LEAST_RATIO
    if np.count_nonzero(known) < LEAST_FEATURES:
        return ratio
    half = 0.5 * freedom
    logs = np.log(ratio[known]) - digamma(half) + np.log(half)
    beyond = float(logs.var(ddof=1) - polygamma(1, half))
    if beyond <= float(polygamma(1, 0.5 * MOST_FREEDOM)):
        prior = MOST_FREEDOM
    else:
        prior = 2.0 * brentq(lambda v: float(polygamma(1, v)) - beyond, 1e-3, 0.5 * MOST_FREEDOM)
    scale = np.exp(logs.mean() + digamma(0.5 * prior) - np.log(0.5 * prior))
    return np.asarray((prior * scale + freedom * ratio) / (prior + freedom))
