"""Rates with bounds, and the severity that is found with certainty (MIL-HDBK-1823A)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

LEVEL = 0.95


class Rate(NamedTuple):
    """A rate with its exact bounds."""

    hits: int
    total: int
    lower: float
    """Two-sided 95 % (Clopper and Pearson 1934)."""
    upper: float

    @property
    def value(self) -> float:
        """The rate itself, NaN of nothing."""
        return self.hits / self.total if self.total else float("nan")


def rate(hits: Sequence[bool] | np.ndarray) -> Rate:
    """Return the rate of `hits`, shape (n,)."""
    return rate_of(int(np.sum(hits)), len(hits))


def rate_of(hits: int, total: int) -> Rate:
    """Return the rate of so many hits of a total."""
    from scipy.stats import binomtest

    if total == 0:
        return Rate(0, 0, 0.0, 1.0)
    bounds = binomtest(hits, total).proportion_ci(LEVEL, method="exact")
    return Rate(hits, total, float(bounds.low), float(bounds.high))


class DetectionCurve(NamedTuple):
    """Probability of detection: log-odds linear in the log of severity, shifted by an origin."""

    intercept: float
    slope: float
    a90: float
    """Severity found in nine of ten records."""
    a90_95: float
    """Its upper 95 % confidence bound."""
    origin: float = 0.0
    """Added to the severity before its logarithm."""


ORIGIN = {"friction": 1.0, "motor_friction": 1.0, "surface_friction": 1.0}
"""Of the curves of detection, see `detection_curve`; others: 0. Chosen on the fleets of the
training itself."""

LARGEST_LOG = 700.0
"""Of a severity: a curve that hardly rises has its bound beyond all numbers."""


def detection_curve(
    severity: np.ndarray, found: np.ndarray, origin: float = 0.0
) -> DetectionCurve | None:
    """Fit the probability of detection; None where it cannot be (all or none found).

    Parameters
    ----------
    severity : ndarray, shape (n,), positive.
    found : ndarray of bool, shape (n,).
    origin : added to the severity: 1 for a growth that multiplies what is there already, such
        as friction, since it is the logarithm of 1 + growth that adds to the units' own spread.

    The bound follows from the fit's covariance by the delta method, one-sided.
    """
    from scipy.optimize import minimize
    from scipy.special import expit

    x, y = np.log(origin + severity), np.asarray(found, dtype=float)
    if y.sum() < 3 or len(y) - y.sum() < 3:
        return None
    center, scale = x.mean(), max(float(x.std()), 1e-9)
    design = np.column_stack([np.ones(len(x)), (x - center) / scale])

    def loss(b: np.ndarray) -> float:
        z = design @ b  # a weak ridge keeps separable data finite
        return float(np.sum(np.logaddexp(0.0, z) - y * z) + 1e-3 * b[1] ** 2)

    b = minimize(loss, np.array([0.0, 3.0]), method="BFGS").x
    if b[1] <= 0.0:
        return None
    p = expit(design @ b)
    covariance = np.linalg.inv((design * (p * (1 - p) + 1e-9)[:, None]).T @ design)
    target = np.log(9.0)
    u = (target - b[0]) / b[1]
    gradient = np.array([-1.0 / b[1], -u / b[1]])
    error = float(np.sqrt(gradient @ covariance @ gradient))
    a90, bound = (float(np.exp(min(center + scale * v, LARGEST_LOG))) - origin
                  for v in (u, u + 1.645 * error))
    slope = b[1] / scale
    return DetectionCurve(float(b[0] - slope * center), float(slope), a90, bound, origin)
