"""How large a shift must be to be found: in Gaussian noise, and among uniform tolerances."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtri
from scipy.stats import chi2, ncx2

FALSE_ALARMS, FOUND = 0.01, 0.90
FOLDS = 6


def needed_shift(directions: int = 1, freedoms: int = 1) -> float:
    """Return the shift (standard deviations) that is found at the stated rates.

    Parameters
    ----------
    directions : tests made at once; each may raise its part of the false alarms.
    freedoms : of a shift whose direction in the plane is not known; 1: known, one-sided.
    """
    rate = FALSE_ALARMS / directions
    if freedoms == 1:
        return float(ndtri(1.0 - rate) + ndtri(FOUND))
    limit = chi2.isf(rate, freedoms)
    return float(np.sqrt(brentq(lambda c: ncx2.sf(limit, freedoms, c) - FOUND, 1e-3, 400.0)))


def own_spread_bound(half: float) -> float:
    """Return the increase that stands out of a factor uniform within 1 ± `half`, exactly."""
    top = 1.0 + half * (1.0 - 2.0 * FALSE_ALARMS)
    low = 1.0 - half * (1.0 - 2.0 * (1.0 - FOUND))
    return top / low - 1.0


def inverse_covariance(samples: np.ndarray) -> np.ndarray:
    """Return the inverse covariance, shape (d, d), freed of the bias of few samples."""
    n, d = samples.shape
    scale = samples.std(axis=0, ddof=1) + 1e-12
    correlation = np.cov(samples / scale, rowvar=False)
    unbiased = (n - d - 2) / (n - 1)  # of an inverse Wishart matrix
    return unbiased * np.linalg.inv(correlation) / np.outer(scale, scale)


def noise_bound(signature: np.ndarray, inverse: np.ndarray, shift: float, records: int) -> float:
    """Return the severity whose shift against the noise of `records` records is `shift`."""
    return float(shift * np.sqrt(records / (signature @ inverse @ signature)))


def projected_noise(
    samples: np.ndarray, spread: np.ndarray, signature: np.ndarray, records: int
) -> tuple[np.ndarray, float]:
    """Return the weights of the best linear test, and the noise's deviation under them.

    The deviation is that of samples that the weights were not made from, in `FOLDS` parts:
    otherwise weights for as many features as there are samples would seem free of noise.

    Parameters
    ----------
    samples : ndarray, shape (n, d). Repeats of one test.
    spread : ndarray, shape (d, d). Covariance of what is not known.
    signature : ndarray, shape (d,). The weights are scaled to give 1 with it.
    records : over which the noise counts.
    """

    def weights(chosen: np.ndarray) -> np.ndarray:
        total = records * np.cov(chosen, rowvar=False) + spread
        scale = np.sqrt(np.diag(total)) + 1e-12
        w = np.linalg.solve(total / np.outer(scale, scale), signature / scale) / scale
        return w / (w @ signature)

    squares = 0.0
    for k in range(FOLDS):
        out = np.arange(len(samples)) % FOLDS == k
        center = samples[~out].mean(axis=0)
        squares += float(np.sum(((samples[out] - center) @ weights(samples[~out])) ** 2))
    return weights(samples), float(np.sqrt(records * squares / len(samples)))


def linear_bound(
    signature: np.ndarray, samples: np.ndarray, conditions: np.ndarray, unit: np.ndarray,
    *, directions: int = 1, freedoms: int = 1, draws: int = 200_000,
) -> float:
    """Return the severity that the best linear test finds against noise and uniform spreads.

    Parameters
    ----------
    signature : ndarray, shape (d,). Shift by severity.
    samples : ndarray, shape (n, d). Repeats of one test.
    conditions : ndarray, shape (m, d). Shift by each condition, at the edge of its spread.
    unit : ndarray, shape (k, d). Shift by each parameter of the unit; none: it is known from
        a baseline, which has noise and conditions of its own.
    directions, freedoms : as in `needed_shift`.
    """
    records = 1 if len(unit) else 2
    shifts = np.concatenate([*([conditions] * records), unit])
    weight, noise = projected_noise(samples, shifts.T @ shifts / 3.0, signature, records)
    rng = np.random.default_rng(990_001)
    score = noise * rng.standard_normal(draws)
    for half in np.abs(shifts @ weight):  # 0 of a parameter that no feature shows
        score += rng.uniform(-half, half, draws)
    rate = FALSE_ALARMS / directions
    found = float(np.quantile(score, 1.0 - rate) - np.quantile(score, 1.0 - FOUND))
    # A direction that is not known costs what it costs in Gaussian noise.
    return found * needed_shift(directions, freedoms) / needed_shift(directions)
