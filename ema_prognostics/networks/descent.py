"""Fit of one perceptron with one hidden layer of tanh: L-BFGS on all records at once.

The loss is the weighted mean of ½ (o − t)², over records and outputs, or of the cross entropy of
a logistic output, and ½ decay / n Σ w² over the weights without biases. Products are taken with
single precision, which is finer than any feature is measured and takes a third of the time;
losses are summed with double precision, so that the line search is not disturbed.

References
----------
Liu, Nocedal: On the limited memory BFGS method for large scale optimization, Math. Programming 45
(1989). Glorot, Bengio: Understanding the difficulty of training deep feedforward neural networks,
AISTATS (2010): the initial weights.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

Loss = Literal["squares", "logistic"]
TOLERANCE = 1e-7
"""Largest component of the gradient at which the descent ends."""
GLOROT = 6.0
MEMORY = 15
"""Steps of which the curvature is kept."""


class Perceptron(NamedTuple):
    """Weights: the output is tanh(x `first` + `first_bias`) `second` + `second_bias`."""

    first: np.ndarray
    """Shape (d, h)."""
    first_bias: np.ndarray
    second: np.ndarray
    """Shape (h, k)."""
    second_bias: np.ndarray


def unpack(w: np.ndarray, d: int, h: int, k: int) -> Perceptron:
    """Return the parts of a vector of d h + h + h k + k weights; they share its memory."""
    a, b, c = d * h, d * h + h, d * h + h + h * k
    return Perceptron(w[:a].reshape(d, h), w[a:b], w[b:c].reshape(h, k), w[c:])


def loss_and_gradient(
    w: np.ndarray, x: np.ndarray, target: np.ndarray, weight: np.ndarray, h: int, loss: Loss,
    decay: float,
) -> tuple[float, np.ndarray]:
    """Return the loss and its gradient by the weights, shape (p,).

    Parameters
    ----------
    w : ndarray, shape (p,), float64. As `unpack` reads them.
    x : ndarray, shape (n, d). Inputs; their precision is that of the products.
    target : ndarray, shape (n, k), of the same precision; 0 or 1 for ``logistic``.
    weight : ndarray, shape (n,). Of the records; they sum to n.
    h : hidden neurons.
    loss : see above.
    decay : penalty on the weights.
    """
    (n, d), k = x.shape, target.shape[1]
    net = unpack(w.astype(x.dtype), d, h, k)
    z = x @ net.first
    z += net.first_bias
    np.tanh(z, out=z)
    o = z @ net.second
    o += net.second_bias
    if loss == "squares":
        error = o - target
        each = 0.5 * np.einsum("nk,nk->n", error, error) / k
        error *= (weight / (n * k))[:, None]
    else:
        each = (np.logaddexp(0.0, o) - target * o).sum(axis=1)
        error = 0.5 + 0.5 * np.tanh(0.5 * o) - target
        error *= (weight / n)[:, None]
    gradient = np.empty(len(w))
    g = unpack(gradient, d, h, k)
    g.second[:] = z.T @ error
    g.second_bias[:] = error.sum(axis=0)
    back = error @ net.second.T
    np.multiply(z, z, out=z)
    np.subtract(1.0, z, out=z)
    back *= z
    g.first[:] = x.T @ back
    g.first_bias[:] = back.sum(axis=0)
    full = unpack(w, d, h, k)
    total = float(np.dot(each.astype(float), weight.astype(float))) / n
    for values, slope in ((full.first, g.first), (full.second, g.second)):
        total += 0.5 * decay / n * float(np.vdot(values, values))
        np.add(slope, decay / n * values, out=slope)
    return total, gradient


def descend(
    x: np.ndarray, target: np.ndarray, *, hidden: int, loss: Loss, decay: float, iterations: int,
    seed: int, weight: np.ndarray | None = None,
) -> Perceptron:
    """Return the perceptron that the descent ends with.

    Parameters
    ----------
    x : ndarray, shape (n, d).
    target : ndarray, shape (n, k).
    hidden : neurons.
    loss, decay : see `loss_and_gradient`.
    iterations : most steps.
    seed : of the initial weights.
    weight : ndarray, shape (n,), of the records; default equal.
    """
    from scipy.optimize import minimize
    from threadpoolctl import threadpool_limits

    (n, d), k = x.shape, target.shape[1]
    rng = np.random.default_rng(seed)
    first, second = np.sqrt(GLOROT / (d + hidden)), np.sqrt(GLOROT / (hidden + k))
    start = np.concatenate([rng.uniform(-first, first, d * hidden + hidden),
                            rng.uniform(-second, second, hidden * k + k)])
    single = np.ascontiguousarray(x, dtype=np.float32), np.ascontiguousarray(
        target, dtype=np.float32)
    even = np.ones(n) if weight is None else weight * (n / weight.sum())
    with threadpool_limits(limits=1):
        found = minimize(
            loss_and_gradient, start, args=(*single, even.astype(np.float32), hidden, loss, decay),
            jac=True, method="L-BFGS-B",
            options={"maxiter": iterations, "maxfun": 2 * iterations, "gtol": TOLERANCE,
                     "ftol": 0.0, "maxcor": MEMORY})
    return unpack(found.x, d, hidden, k)
