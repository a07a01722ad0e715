"""Linear least squares within bounds."""

from __future__ import annotations

import numpy as np
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
    root = np.sqrt(weight)
    rows, rest = np.vstack([columns, np.diag(root)]), np.append(target, -root * centre)
    scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-12)
    basis, triangle = np.linalg.qr(rows / scale)
    found = lsq_linear(triangle, basis.T @ rest, bounds=(low * scale, high * scale),
                       method="bvls")
    return np.clip(np.asarray(found.x) / scale, low, high)
