"""Parameters of greatest posterior density from features that are nearly linear in them.

Gelman et al., Bayesian Data Analysis, 2013, 14.8: the prior counts as further observations.
"""

from __future__ import annotations

import numpy as np

SURE = 3.0
"""Errors from which a slope counts: by chance one of four hundred does."""
BEYOND, TURNS = 3.0, 20
"""Errors beyond which a feature of the estimate is no longer taken as due to parameters (Huber
1964: it weighs as if it were that many off); repetitions of this."""


def estimate(
    parameters: np.ndarray, features: np.ndarray, measured: np.ndarray, prior: np.ndarray,
    error: np.ndarray, units: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameters of greatest posterior density of a linear model of the features.

    With them, shape (p,), the covariance of their errors, shape (p, p).

    Parameters
    ----------
    parameters : ndarray, shape (n, p). Of the draws; 0 is what the prior expects.
    features : ndarray, shape (n, d). Of their tests.
    measured : ndarray, shape (d,).
    prior : ndarray, shape (p,). Standard deviations.
    error : ndarray, shape (d,). Standard deviation of that of `measured`, a mean of `units`.
    """
    level, jacobian, scatter = _slopes(parameters, features)
    wanted = measured - level + jacobian @ parameters.mean(axis=0)
    error = np.hypot(error, scatter / np.sqrt(units))
    now = error
    for _ in range(TURNS):
        weighed = jacobian / now[:, None]**2
        inverse = np.linalg.inv(weighed.T @ jacobian + np.diag(prior**-2.0))
        value = inverse @ weighed.T @ wanted
        now = np.maximum(error, np.abs(wanted - jacobian @ value) / BEYOND)
    return value, inverse


def _slopes(
    parameters: np.ndarray, features: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the slopes by least squares; those of less than `SURE` of their errors are 0.

    Else a hundred features that tell nothing of a parameter would tell much together. Before
    them, shape (d, p), stand the features at the mean of the parameters, shape (d,), and after
    them the standard deviation of the features about the model, shape (d,).
    """
    design = np.column_stack(
        [np.ones(len(parameters)), parameters - parameters.mean(axis=0)])
    slopes, *_ = np.linalg.lstsq(design, features, rcond=None)
    freedom = max(len(design) - design.shape[1], 1)
    scatter = np.sqrt(np.sum((features - design @ slopes)**2, axis=0) / freedom)
    error = np.sqrt(np.diag(np.linalg.inv(design.T @ design))[1:])[:, None] * scatter
    sure = np.where(np.abs(slopes[1:]) > SURE * error, slopes[1:], 0.0)
    return slopes[0], sure.T, scatter
