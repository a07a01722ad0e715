"""Training of single networks: an ensemble of small ones, kept as one.

Each member is a perceptron with one hidden layer of tanh, trained by scikit-learn. Since
tanh z = 2 logsig(2z) − 1, members are rewritten with the log-sigmoid of the paper, and the mean
of their outputs before the last law is again one network with all their hidden neurons.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from ema_prognostics.network import Network, OutputLaw

MEMBERS = 4
WEIGHT_DECAY = 0.1
LEARNING_RATE = 5e-3
BATCH = 256


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


def _settings(hidden: int, epochs: int, seed: int, rows: int, decay: float) -> dict[str, Any]:
    return {
        "hidden_layer_sizes": (hidden,), "activation": "tanh", "alpha": decay,
        "learning_rate_init": LEARNING_RATE, "batch_size": min(BATCH, rows),
        "max_iter": epochs, "random_state": seed, "tol": 1e-7, "n_iter_no_change": epochs,
    }


def fit_classifier(
    x: np.ndarray, y: np.ndarray, *, hidden: int, epochs: int, seed: int,
    members: int = MEMBERS,
) -> Network:
    """Return a network for the probability of `y`.

    Parameters
    ----------
    x : ndarray, shape (n, d).
    y : ndarray of bool, shape (n,).
    hidden : neurons of each member.
    epochs : passes through the data.
    seed : of the first member; the others count on.
    members : of the ensemble.
    """
    from sklearn.neural_network import MLPClassifier

    fitted = [
        _fit(MLPClassifier(**_settings(hidden, epochs, seed + 1000 * m, len(x), WEIGHT_DECAY)),
             x, y.astype(int))
        for m in range(members)
    ]
    return _merged(fitted, "logsig", np.zeros(1), np.ones(1))


def fit_regressor(
    x: np.ndarray, y: np.ndarray, *, hidden: int, epochs: int, seed: int, members: int = 1,
    decay: float = 0.01,
) -> Network:
    """Return a network for the quantities `y`, shape (n, k), by least squares.

    Parameters as those of `fit_classifier`; `decay` is the penalty on the weights.
    """
    from sklearn.neural_network import MLPRegressor

    mean, scale = y.mean(axis=0), np.maximum(y.std(axis=0), 1e-6)
    target = (y - mean) / scale
    fitted = [
        _fit(MLPRegressor(**_settings(hidden, epochs, seed + 1000 * m, len(x), decay)),
             x, target if target.shape[1] > 1 else target[:, 0])
        for m in range(members)
    ]
    return _merged(fitted, "linear", mean, scale)
