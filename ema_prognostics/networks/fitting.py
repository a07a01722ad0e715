"""Training of single networks: an ensemble of small ones, kept as one.

Each member is a perceptron with one hidden layer of tanh, trained by scikit-learn with L-BFGS on
all records at once (Adam in batches left severities two to four times less exact). Since
tanh z = 2 logsig(2z) − 1, members are rewritten with the log-sigmoid of the paper, and the mean
of their outputs before the last law is again one network with all their hidden neurons.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from ema_prognostics.networks.network import Network, OutputLaw

MEMBERS = 4
WEIGHT_DECAY = 10.0
"""Penalty on the weights of a classifier."""


def _fit(estimator: Any, x: np.ndarray, y: np.ndarray) -> Any:
    from sklearn.exceptions import ConvergenceWarning
    from threadpoolctl import threadpool_limits

    with warnings.catch_warnings(), threadpool_limits(limits=1):
        warnings.simplefilter("ignore", ConvergenceWarning)
        return estimator.fit(x, y)


def _merged(fitted: list[Any], law: OutputLaw, mean: np.ndarray, scale: np.ndarray) -> Network:
    """Return the mean of tanh networks as one network of log-sigmoids."""
    share = 1.0 / len(fitted)
    d = fitted[0].coefs_[0].shape[0]
    output_bias = np.zeros(fitted[0].coefs_[1].shape[1])
    for f in fitted:
        output_bias += share * (f.intercepts_[1] - f.coefs_[1].sum(axis=0))
    return Network(
        input_mean=np.zeros(d), input_scale=np.ones(d),
        hidden_weights=np.hstack([2.0 * f.coefs_[0] for f in fitted]),
        hidden_bias=np.concatenate([2.0 * f.intercepts_[0] for f in fitted]),
        output_weights=np.vstack([2.0 * share * f.coefs_[1] for f in fitted]),
        output_bias=output_bias, output_law=law, output_mean=mean, output_scale=scale,
    )


def _settings(hidden: int, iterations: int, seed: int, decay: float) -> dict[str, Any]:
    return {
        "hidden_layer_sizes": (hidden,), "activation": "tanh", "alpha": decay,
        "solver": "lbfgs", "max_iter": iterations, "max_fun": 2 * iterations,
        "random_state": seed, "tol": 1e-7,
    }


def fit_classifier(
    x: np.ndarray, y: np.ndarray, *, hidden: int, iterations: int, seed: int,
    members: int = MEMBERS,
) -> Network:
    """Return a network for the probability of `y`.

    Parameters
    ----------
    x : ndarray, shape (n, d).
    y : ndarray of bool, shape (n,).
    hidden : neurons of each member.
    iterations : most steps of the optimiser (L-BFGS, all records at once).
    seed : of the first member; the others count on.
    members : of the ensemble.
    """
    from sklearn.neural_network import MLPClassifier

    fitted = [
        _fit(MLPClassifier(**_settings(hidden, iterations, seed + 1000 * m, WEIGHT_DECAY)),
             x, y.astype(int))
        for m in range(members)
    ]
    return _merged(fitted, "logsig", np.zeros(1), np.ones(1))


def fit_regressor(
    x: np.ndarray, y: np.ndarray, *, hidden: int, iterations: int, seed: int, members: int = 1,
    decay: float = 1.0,
) -> Network:
    """Return a network for the quantities `y`, shape (n, k), by least squares.

    Parameters as those of `fit_classifier`; `decay` is the penalty on the weights.
    """
    from sklearn.neural_network import MLPRegressor

    mean, scale = y.mean(axis=0), np.maximum(y.std(axis=0), 1e-6)
    target = (y - mean) / scale
    fitted = [
        _fit(MLPRegressor(**_settings(hidden, iterations, seed + 1000 * m, decay)),
             x, target if target.shape[1] > 1 else target[:, 0])
        for m in range(members)
    ]
    return _merged(fitted, "linear", mean, scale)


def as_classifier(network: Network, value: np.ndarray, there: np.ndarray) -> Network:
    """Return a network for the probability of `there` that grows with a quantity's network.

    Parameters
    ----------
    network : of one quantity.
    value : ndarray, shape (n,). The quantity of records.
    there : ndarray of bool, shape (n,).
    """
    from sklearn.linear_model import LogisticRegression

    scale = max(float(value.std()), 1e-9)
    fitted = LogisticRegression(C=100.0).fit(value[:, None] / scale, there)
    slope = float(fitted.coef_[0, 0]) / scale
    bias = float(fitted.intercept_[0])
    gain, offset = float(network.output_scale[0]), float(network.output_mean[0])
    return replace(
        network, output_weights=slope * gain * network.output_weights,
        output_bias=slope * (gain * network.output_bias + offset) + bias,
        output_law="logsig", output_mean=np.zeros(1), output_scale=np.ones(1),
    )
