"""Perceptrons with one hidden layer, trained by Levenberg-Marquardt with an analytic Jacobian.

Scikit-learn style: hyper-parameters in ``__init__`` only, fitted attributes end in ``_``.
Training is deterministic: the same data and seed give the same bytes (one BLAS thread).

References
----------
Hagan, Menhaj: Training feedforward networks with the Marquardt algorithm, IEEE Trans.
Neural Networks 5 (1994). More: The Levenberg-Marquardt algorithm, implementation and
theory, LNM 630 (1978), the MINPACK routine behind ``scipy.optimize.least_squares``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import least_squares
from sklearn.base import BaseEstimator, ClassifierMixin, RegressorMixin
from sklearn.preprocessing import LabelBinarizer
from sklearn.utils import check_random_state
from sklearn.utils.multiclass import check_classification_targets, type_of_target
from sklearn.utils.validation import check_is_fitted, column_or_1d, validate_data
from threadpoolctl import threadpool_limits

from ema_prognostics.networks.network import Network, OutputLaw, logsig


def n_weights(d: int, h: int, k: int) -> int:
    """Return the number of weights of a network d - h - k, biases included."""
    return d * h + h + h * k + k


def unpack(
    w: np.ndarray, d: int, h: int, k: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Split the weight vector into (d, h), (h,), (h, k), (k,)."""
    a, b, c = d * h, d * h + h, d * h + h + h * k
    return w[:a].reshape(d, h), w[a:b], w[b:c].reshape(h, k), w[c:]


def residuals(
    w: np.ndarray, x: np.ndarray, t: np.ndarray, h: int, law: OutputLaw, alpha: float
) -> np.ndarray:
    """Return outputs minus targets, flat, then sqrt(alpha) w.

    Parameters
    ----------
    w : ndarray, shape (p,). Weights, as `unpack` reads them.
    x : ndarray, shape (n, d). Scaled inputs.
    t : ndarray, shape (n, k). Targets.
    h : hidden neurons.
    law : output law.
    alpha : weight decay; the cost is the sum of squares of what is returned, halved.

    Returns
    -------
    ndarray, shape (n k + p,).
    """
    n, d = x.shape
    k = t.shape[1]
    w1, b1, w2, b2 = unpack(w, d, h, k)
    y = logsig(x @ w1 + b1) @ w2 + b2
    if law == "logsig":
        y = logsig(y)
    out = np.empty(n * k + len(w))
    out[: n * k] = (y - t).ravel()
    out[n * k:] = np.sqrt(alpha) * w
    return out


def jacobian(
    w: np.ndarray, x: np.ndarray, t: np.ndarray, h: int, law: OutputLaw, alpha: float
) -> np.ndarray:
    """Return the derivative of `residuals` by the weights, shape (n k + p, p)."""
    n, d = x.shape
    k = t.shape[1]
    w1, b1, w2, b2 = unpack(w, d, h, k)
    z = logsig(x @ w1 + b1)
    p = len(w)
    slope = np.ones((n, k))
    if law == "logsig":
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


class _LevenbergMarquardt(BaseEstimator):
    """What both estimators share: scaling, restarts, the fit of the weights."""

    hidden: int
    alpha: float
    n_restarts: int
    max_nfev: int
    tol: float
    random_state: Any

    def _fit_weights(self, x: np.ndarray, t: np.ndarray, law: OutputLaw) -> None:
        if self.hidden < 1 or self.n_restarts < 1 or self.max_nfev < 1 or self.alpha <= 0.0:
            raise ValueError(
                f"hidden {self.hidden}, n_restarts {self.n_restarts} and max_nfev "
                f"{self.max_nfev} must be at least 1, alpha {self.alpha} above 0"
            )
        rng = check_random_state(self.random_state)
        self.input_mean_ = x.mean(axis=0)
        scale = x.std(axis=0)
        tiny = 1e-12 * np.maximum(np.abs(self.input_mean_), 1.0)
        self.input_scale_ = np.where(scale > tiny, scale, 1.0)
        scaled = (x - self.input_mean_) / self.input_scale_
        d, k, h = x.shape[1], t.shape[1], self.hidden
        best = None
        self.costs_ = []
        with threadpool_limits(limits=1):
            for _ in range(self.n_restarts):
                start = rng.normal(size=n_weights(d, h, k))
                start[: d * h] /= np.sqrt(d)
                start[d * h + h:-k] /= np.sqrt(h)
                found = least_squares(
                    residuals, start, jac=jacobian, method="lm", ftol=self.tol, xtol=self.tol,
                    gtol=self.tol, max_nfev=self.max_nfev,
                    args=(scaled, t, h, law, self.alpha),
                )
                self.costs_.append(float(found.cost))
                if best is None or found.cost < best.cost:
                    best = found
        assert best is not None
        self.weights_ = best.x
        self.cost_ = float(best.cost)
        self.n_iter_ = int(best.nfev)
        self.n_outputs_ = k
        self._law_: OutputLaw = law

    def to_network(self) -> Network:
        """Return the trained network as plain arrays."""
        check_is_fitted(self)
        d, k = self.n_features_in_, self.n_outputs_
        w1, b1, w2, b2 = unpack(self.weights_, d, self.hidden, k)
        return Network(
            input_mean=self.input_mean_, input_scale=self.input_scale_, hidden_weights=w1,
            hidden_bias=b1, output_weights=w2, output_bias=b2, output_law=self._law_,
            output_mean=getattr(self, "output_mean_", np.zeros(k)),
            output_scale=getattr(self, "output_scale_", np.ones(k)),
        )


class LevenbergMarquardtClassifier(ClassifierMixin, _LevenbergMarquardt):
    """Pattern recognition: log-sigmoid hidden and output layer, least squares to 0 and 1.

    Parameters
    ----------
    hidden : neurons of the hidden layer.
    alpha : weight decay, relative to one squared residual.
    n_restarts : fits from different random weights; the lowest cost is kept.
    max_nfev : evaluations a fit.
    tol : relative tolerance of cost, weights and gradient.
    random_state : seed of the initial weights.

    Attributes
    ----------
    classes_ : ndarray, shape (k,). Labels, or column numbers of a multi-label target.
    weights_ : ndarray, shape (p,). cost_, costs_, n_iter_ : of the fit kept, of all fits.
    """

    def __init__(
        self, hidden: int = 8, *, alpha: float = 1e-3, n_restarts: int = 2, max_nfev: int = 200,
        tol: float = 1e-8, random_state: int | None = 0,
    ) -> None:
        self.hidden = hidden
        self.alpha = alpha
        self.n_restarts = n_restarts
        self.max_nfev = max_nfev
        self.tol = tol
        self.random_state = random_state

    def __sklearn_tags__(self) -> Any:
        """Declare that multi-label targets are accepted."""
        tags = super().__sklearn_tags__()
        tags.classifier_tags.multi_label = True
        return tags

    def fit(self, X: Any, y: Any) -> LevenbergMarquardtClassifier:
        """Train on inputs (n, d) and labels (n,), or an indicator matrix (n, k) of columns.

        A row of the matrix may hold more than one 1: the paper's targets share a row at
        each cut.
        """
        X, y = validate_data(self, X, y, multi_output=True, dtype=np.float64)
        check_classification_targets(y)
        if y.ndim == 2 and y.shape[1] == 1:
            y = column_or_1d(y, warn=True)
        self.multilabel_ = type_of_target(y).startswith("multilabel")
        if self.multilabel_:
            self.classes_ = np.arange(y.shape[1])
            target = np.asarray(y, dtype=float)
        else:
            self._binarizer = LabelBinarizer().fit(y)
            self.classes_ = self._binarizer.classes_
            target = np.asarray(self._binarizer.transform(y), dtype=float)
            if len(self.classes_) == 2:
                target = np.hstack([1.0 - target, target])
        self._fit_weights(X, target, "logsig")
        return self

    def outputs(self, X: Any) -> np.ndarray:
        """Return the log-sigmoid outputs, shape (n, k), each in 0..1; rows need not sum to 1."""
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        return self.to_network()(X)

    def predict_proba(self, X: Any) -> np.ndarray:
        """Return the outputs, shape (n, k); scaled to sum 1 unless the target was multi-label."""
        y = self.outputs(X)
        if self.multilabel_:
            return y
        total = y.sum(axis=1, keepdims=True)
        return np.where(total > 0.0, y / np.where(total > 0.0, total, 1.0), 1.0 / y.shape[1])

    def predict(self, X: Any) -> np.ndarray:
        """Return the labels (n,) of the largest output, or the indicator matrix (n, k)."""
        y = self.outputs(X)
        if self.multilabel_:
            return (y > 0.5).astype(int)
        return self.classes_[np.argmax(y, axis=1)]


class LevenbergMarquardtRegressor(RegressorMixin, _LevenbergMarquardt):
    """A quantity: log-sigmoid hidden layer, linear outputs on scaled targets.

    Parameters and attributes as in `LevenbergMarquardtClassifier`.
    """

    def __init__(
        self, hidden: int = 8, *, alpha: float = 1e-3, n_restarts: int = 2, max_nfev: int = 200,
        tol: float = 1e-8, random_state: int | None = 0,
    ) -> None:
        self.hidden = hidden
        self.alpha = alpha
        self.n_restarts = n_restarts
        self.max_nfev = max_nfev
        self.tol = tol
        self.random_state = random_state

    def fit(self, X: Any, y: Any) -> LevenbergMarquardtRegressor:
        """Train on inputs (n, d) and quantities (n,) or (n, k)."""
        X, y = validate_data(
            self, X, y, multi_output=True, y_numeric=True, dtype=np.float64
        )
        if y.ndim == 2 and y.shape[1] == 1:
            y = column_or_1d(y, warn=True)
        self._flat = y.ndim == 1
        target = np.asarray(y, dtype=float).reshape(len(X), -1)
        self.output_mean_ = target.mean(axis=0)
        scale = target.std(axis=0)
        self.output_scale_ = np.where(scale > 0.0, scale, 1.0)
        self._fit_weights(X, (target - self.output_mean_) / self.output_scale_, "linear")
        return self

    def predict(self, X: Any) -> np.ndarray:
        """Return the quantities, shape (n,) or (n, k) as in `fit`."""
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        y = self.to_network()(X)
        return y[:, 0] if self._flat else y
