"""Training of single networks: an ensemble of small ones, kept as one.

Each member is a perceptron with one hidden layer of tanh, see `descent` (Adam in batches left
severities two to four times less exact). Since tanh z = 2 logsig(2z) − 1, members are rewritten
with the log-sigmoid of the paper, and the mean of their outputs before the last law is again one
network with all their hidden neurons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ema_prognostics.networks.descent import Perceptron, descend
from ema_prognostics.networks.network import Network, OutputLaw

MEMBERS = 4
WEIGHT_DECAY = 10.0
"""Penalty on the weights of a classifier."""
NEXT_SEED = 1000
"""From the seed of a member to that of the next."""


def merged(members: Sequence[Perceptron], law: OutputLaw, mean: np.ndarray, scale: np.ndarray
           ) -> Network:
    """Return the mean of tanh networks as one network of log-sigmoids."""
    share = 1.0 / len(members)
    d, k = len(members[0].first), len(members[0].second_bias)
    output_bias = np.zeros(k)
    for m in members:
        output_bias += share * (m.second_bias - m.second.sum(axis=0))
    return Network(
        input_mean=np.zeros(d), input_scale=np.ones(d),
        hidden_weights=np.hstack([2.0 * m.first for m in members]),
        hidden_bias=np.concatenate([2.0 * m.first_bias for m in members]),
        output_weights=np.vstack([2.0 * share * m.second for m in members]),
        output_bias=output_bias, output_law=law, output_mean=mean, output_scale=scale,
    )


def fit_classifier(
    x: np.ndarray, y: np.ndarray, *, hidden: int, iterations: int, seed: int,
    members: int = MEMBERS, weight: np.ndarray | None = None,
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
    weight : ndarray, shape (n,). Of the records, default equal.
    """
    found = [
        descend(x, y.astype(float)[:, None], hidden=hidden, loss="logistic", decay=WEIGHT_DECAY,
                iterations=iterations, seed=seed + NEXT_SEED * m, weight=weight)
        for m in range(members)
    ]
    return merged(found, "logsig", np.zeros(1), np.ones(1))


def fit_regressor(
    x: np.ndarray, y: np.ndarray, *, hidden: int, iterations: int, seed: int, members: int = 1,
    decay: float = 1.0, weight: np.ndarray | None = None,
) -> Network:
    """Return a network for the quantities `y`, shape (n, k), by least squares.

    Parameters as those of `fit_classifier`; `decay` is the penalty on the weights.
    """
    mean, scale = y.mean(axis=0), np.maximum(y.std(axis=0), 1e-6)
    target = (y - mean) / scale
    found = [
        descend(x, target, hidden=hidden, loss="squares", decay=decay, iterations=iterations,
                seed=seed + NEXT_SEED * m, weight=weight)
        for m in range(members)
    ]
    return merged(found, "linear", mean, scale)


def as_classifier(
    network: Network, value: np.ndarray, there: np.ndarray, weight: np.ndarray | None = None,
) -> Network:
    """Return a network for the probability of `there` that grows with a quantity's network.

    Parameters
    ----------
    network : of one quantity.
    value : ndarray, shape (n,). The quantity of records.
    there : ndarray of bool, shape (n,).
    weight : ndarray, shape (n,). Of the records, default equal.
    """
    from sklearn.linear_model import LogisticRegression

    scale = max(float(value.std()), 1e-9)
    fitted = LogisticRegression(C=100.0).fit(
        value[:, None] / scale, there, sample_weight=weight)
    slope = float(fitted.coef_[0, 0]) / scale
    bias = float(fitted.intercept_[0])
    gain, offset = float(network.output_scale[0]), float(network.output_mean[0])
    return replace(
        network, output_weights=slope * gain * network.output_weights,
        output_bias=slope * (gain * network.output_bias + offset) + bias,
        output_law="logsig", output_mean=np.zeros(1), output_scale=np.ones(1),
    )
