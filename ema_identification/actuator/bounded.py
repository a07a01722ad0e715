"""Least squares within bounds: what a recalibration may do, and no more."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear


def bounded_least_squares(
    columns: np.ndarray, target: np.ndarray, low: np.ndarray, high: np.ndarray,
    weight: np.ndarray, centre: np.ndarray,
) -> np.ndarray:
    """Return the step within bounds that leaves least.

    Parameters
    ----------
    columns : ndarray, shape (d, m). Whitened slopes.
    target : ndarray, shape (d,). Whitened residual.
    low, high : ndarrays, shape (m,). Bounds of the step; low < high.
    weight : ndarray, shape (m,). Of the squares of ``centre + step``, added to the sum.
    centre : ndarray, shape (m,). Where the step begins.

    Returns
    -------
    ndarray, shape (m,).
    """
    scale = np.maximum(np.sqrt((columns**2).sum(axis=0) + weight), 1e-12)
    information = (columns.T @ columns + np.diag(weight)) / np.outer(scale, scale)
    pull = (columns.T @ target - weight * centre) / scale
    root = cholesky(information + 1e-9 * np.eye(len(scale)), lower=True)
    found = lsq_linear(
        root.T, solve_triangular(root, pull, lower=True), bounds=(low * scale, high * scale),
        method="bvls")
    return np.clip(np.asarray(found.x) / scale, low, high)
