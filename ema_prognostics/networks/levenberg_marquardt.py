"""Perceptrons with one hidden layer, trained by Levenberg-Marquardt with an analytic Jacobian.

Log-sigmoid hidden and output layer, least squares to 0 and 1 (the paper's pattern recognition).
Training is deterministic: the same data and seed give the same bytes (one BLAS thread).

References
----------
Hagan, Menhaj: Training feedforward networks with the Marquardt algorithm, IEEE Trans.
Neural Networks 5 (1994). More: The Levenberg-Marquardt algorithm, implementation and
theory, LNM 630 (1978), the MINPACK routine behind ``scipy.optimize.least_squares``.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from sklearn.utils import check_random_state
from threadpoolctl import threadpool_limits

from ema_prognostics.networks.descent import unpack
from ema_prognostics.networks.network import Network, logsig

TOLERANCE = 1e-8
"""Relative, of cost, weights and gradient."""
MAX_EVALUATIONS = 200
"""Of a fit."""


def residuals(
    w: np.ndarray, x: np.ndarray, t: np.ndarray, h: int, alpha: float
) -> np.ndarray:
    """Return outputs minus targets, flat, then sqrt(alpha) w, shape (n k + p,).

    Parameters
    ----------
    w : ndarray, shape (p,). Weights, as `unpack` reads them.
    x : ndarray, shape (n, d). Scaled inputs.
    t : ndarray, shape (n, k). Targets.
    h : hidden neurons.
    alpha : weight decay; the cost is the sum of squares of what is returned, halved.
    """
    n, d = x.shape
    k = t.shape[1]
    w1, b1, w2, b2 = unpack(w, d, h, k)
    y = logsig(logsig(x @ w1 + b1) @ w2 + b2)
    out = np.empty(n * k + len(w))
    out[: n * k] = (y - t).ravel()
    out[n * k:] = np.sqrt(alpha) * w
    return out


def jacobian(
    w: np.ndarray, x: np.ndarray, t: np.ndarray, h: int, alpha: float
) -> np.ndarray:
    """Return the derivative of `residuals` by the weights, shape (n k + p, p)."""
    n, d = x.shape
    k = t.shape[1]
    w1, b1, w2, b2 = unpack(w, d, h, k)
    z = logsig(x @ w1 + b1)
    p = len(w)
    y = logsig(z @ w2 + b2)
    slope = y * (1.0 - y)
    full = np.zeros((n * k + p, p))
    jac = full[: n * k].reshape(n, k, p)
    back = slope[:, :, None] * w2.T[None] * (z * (1.0 - z))[:, None, :]  # (n, k, h)
    a, b, c = d * h, d * h + h, d * h + h + h * k
    jac[:, :, :a] = (x[:, None, :, None] * back[:, :, None, :]).reshape(n, k, a)
    jac[:, :, a:b] = back
    for output in range(k):
        jac[:, output, b + output:c:k] = slope[:, output, None] * z
        jac[:, output, c + output] = slope[:, output]
    full[n * k + np.arange(p), np.arange(p)] = np.sqrt(alpha)
    return full


def train(
    x: np.ndarray, t: np.ndarray, *, hidden: int = 8, alpha: float = 1e-3, n_restarts: int = 2,
    seed: int = 0,
) -> Network:
    """Return the network of the lowest cost over fits from different random weights.

    Parameters
    ----------
    x : ndarray, shape (n, d). Inputs.
    t : ndarray, shape (n, k). Targets, 0 or 1; a row may hold more than one 1: the paper's
        targets share a row at each cut.
    hidden : neurons of the hidden layer.
    alpha : weight decay, relative to one squared residual.
    n_restarts : fits.
    seed : of the initial weights.
    """
    rng = check_random_state(seed)
    mean, scale = x.mean(axis=0), x.std(axis=0)
    scale = np.where(scale > 1e-12 * np.maximum(np.abs(mean), 1.0), scale, 1.0)
    d, k = x.shape[1], t.shape[1]
    fits = []
    with threadpool_limits(limits=1):
        for _ in range(n_restarts):
            start = rng.normal(size=(d + 1) * hidden + (hidden + 1) * k)
            start[: d * hidden] /= np.sqrt(d)
            start[d * hidden + hidden:-k] /= np.sqrt(hidden)
            fits.append(least_squares(
                residuals, start, jac=jacobian, method="lm", ftol=TOLERANCE, xtol=TOLERANCE,
                gtol=TOLERANCE, max_nfev=MAX_EVALUATIONS,
                args=((x - mean) / scale, t, hidden, alpha),
            ))
    w1, b1, w2, b2 = unpack(min(fits, key=lambda fit: fit.cost).x, d, hidden, k)
    return Network(
        input_mean=mean, input_scale=scale, hidden_weights=w1, hidden_bias=b1,
        output_weights=w2, output_bias=b2, output_law="logsig", output_mean=np.zeros(k),
        output_scale=np.ones(k),
    )
