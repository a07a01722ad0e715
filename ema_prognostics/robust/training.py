"""Training of the cascade on a campaign: networks, thresholds, interval widths, guard."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from ema_prognostics.robust.calibration import bin_widths, tail_quantile
from ema_prognostics.robust.campaign import Campaign
from ema_prognostics.robust.cascade import logit
from ema_prognostics.robust.conditions import OUTPUTS
from ema_prognostics.robust.guard import FLOOR, NOT_CHECKED, drivers_of
from ema_prognostics.robust.model import (
    GuardData,
    NetworkData,
    SeverityData,
    View,
    ViewData,
)
from ema_prognostics.robust.vector import difference_names, differences, rotate, squash

UNITS = {"short": 2e-3, "eccentricity": 2e-3, "motor_friction": 0.05, "surface_friction": 0.05,
         "backlash": 3e-5}
"""Severity below which a network's target is linear (of each class)."""
FALSE_ALARMS = 0.0008
"""Rate of healthy records that each of the seven outputs may announce."""
GUARD_RATE = 0.003
"""Rate of known records that the guard may turn away."""
HELD_BACK = 5
"""One unit in this many calibrates instead of training."""


def _mlp(estimator: Any, x: np.ndarray, y: np.ndarray) -> Any:
    from sklearn.exceptions import ConvergenceWarning
    from threadpoolctl import threadpool_limits

    with warnings.catch_warnings(), threadpool_limits(limits=1):
        warnings.simplefilter("ignore", ConvergenceWarning)
        return estimator.fit(x, y)


def _data(fitted: Any, law: str, mean: np.ndarray, scale: np.ndarray) -> NetworkData:
    def numbers(a: np.ndarray) -> Any:
        return np.vectorize(lambda v: float(f"{v:.7g}"))(a).tolist()

    w1, w2 = fitted.coefs_
    b1, b2 = fitted.intercepts_
    return NetworkData.model_validate({
        "hidden_weights": numbers(w1), "hidden_bias": numbers(b1), "output_weights": numbers(w2),
        "output_bias": numbers(b2), "output_law": law, "output_mean": numbers(mean),
        "output_scale": numbers(scale),
    })


def _regression(
    x: np.ndarray, y: np.ndarray, *, hidden: int, seed: int, epochs: int
) -> NetworkData:
    """Fit y, shape (n, k), by least squares."""
    from sklearn.neural_network import MLPRegressor

    mean, scale = y.mean(axis=0), np.maximum(y.std(axis=0), 1e-6)
    fitted = _mlp(MLPRegressor(
        hidden_layer_sizes=(hidden,), activation="logistic", alpha=1e-3,
        learning_rate_init=4e-3, batch_size=min(128, len(x)),
        max_iter=epochs, random_state=seed, tol=1e-6, n_iter_no_change=15,
    ), x, (y - mean) / scale if y.shape[1] > 1 else ((y - mean) / scale)[:, 0])
    return _data(fitted, "linear", mean, scale)


def _which(
    x: np.ndarray, y: np.ndarray, *, hidden: int, seed: int, epochs: int
) -> NetworkData:
    """Fit the indicators y, shape (n, 7)."""
    from sklearn.neural_network import MLPClassifier

    fitted = _mlp(MLPClassifier(
        hidden_layer_sizes=(hidden,), activation="logistic", alpha=1e-3,
        learning_rate_init=4e-3, batch_size=min(256, len(x)),
        max_iter=epochs, random_state=seed, tol=1e-6, n_iter_no_change=15,
    ), x, y)
    k = y.shape[1]
    return _data(fitted, "logsig", np.zeros(k), np.ones(k))


def view_inputs(campaign: Campaign, view: View) -> tuple[list[str], np.ndarray]:
    """Return the names and the inputs of a view, shape (n, d)."""
    names = list(campaign.names)
    if view == "fleet":
        return names, campaign.record
    return difference_names(names), differences(names, campaign.record, campaign.baseline)


def _turn_labels(y: np.ndarray, thirds: int) -> np.ndarray:
    """Return severities, shape (n, 7), after `vector.rotate` by `thirds`."""
    out = y.copy()
    out[:, :3] = np.roll(y[:, :3], -thirds, axis=1)
    return out


def train_view(
    campaign: Campaign, healthy: Campaign, kind: str, view: View, *, seed: int,
    hidden: int = 48, epochs: int = 80, progress: Callable[[str], None] = lambda _: None,
) -> ViewData:
    """Return the cascade of one view.

    Parameters
    ----------
    campaign : units with and without faults; one unit in `HELD_BACK` calibrates.
    healthy : other units, healthy only; they set the thresholds.
    kind : of the test.
    view : with or without baseline.
    seed : of the networks' weights.
    hidden, epochs : size of the first network; passes through the data.
    progress : called with what begins.
    """
    names, x = view_inputs(campaign, view)
    y = campaign.severity
    fit = campaign.unit % HELD_BACK != 0
    _, sound = view_inputs(healthy, view)
    none = (y == 0.0).all(axis=1)
    reference = x[fit & none]
    if view == "fleet":  # every acceptance record is a healthy one
        reference = np.vstack([reference, campaign.baseline[fit]])
        sound = np.vstack([sound, healthy.baseline])
    else:  # either of two healthy records may be the baseline
        n = list(campaign.names)
        sound = np.vstack([sound, differences(n, healthy.baseline, healthy.record)])
    center = np.median(reference, axis=0)
    spread = np.maximum(reference.std(axis=0), 1e-6)

    def inputs(values: np.ndarray) -> np.ndarray:
        return squash(values, center, spread)

    extra = campaign.baseline[fit] if view == "fleet" else np.empty((0, x.shape[1]))
    xs = np.vstack([x[fit], extra])
    ys = np.vstack([y[fit], np.zeros((len(extra), y.shape[1]))])
    turned = [(inputs(rotate(xs, names, k)), _turn_labels(ys, k)) for k in range(3)]
    xa = np.vstack([t[0] for t in turned])
    ya = np.vstack([t[1] for t in turned])
    progress("which fault")
    which = _which(xa, (ya > 0.0).astype(int), hidden=hidden, seed=seed, epochs=epochs)
    score = np.vstack([
        logit(which.build()(inputs(rotate(sound, names, k)))) for k in range(3)
    ])
    threshold = np.array([tail_quantile(score[:, k], FALSE_ALARMS) for k in range(len(OUTPUTS))])
    threshold[:3] = threshold[:3].max()
    progress("how much")
    severity = _severities(xa, ya, x, y, fit, names, inputs, seed, epochs)
    guard = None
    if view == "fleet":
        progress("guard")
        known = np.vstack([inputs(x[fit]), inputs(campaign.baseline[fit])])
        other = np.vstack([inputs(x[~fit]), inputs(sound)])
        guard = train_guard(known, other, names, kind, seed=seed, epochs=epochs)
    return ViewData(
        names=names, center=center.tolist(), spread=spread.tolist(), which=which,
        threshold=threshold.tolist(), severity=severity, guard=guard,
    )


def _severities(
    xa: np.ndarray, ya: np.ndarray, x: np.ndarray, y: np.ndarray, fit: np.ndarray,
    names: list[str], inputs: Callable[[np.ndarray], np.ndarray], seed: int,
    epochs: int,
) -> dict[str, SeverityData]:
    found = {}
    for name, unit in UNITS.items():
        column = 0 if name == "short" else OUTPUTS.index(name)
        rows = ya[:, column] > 0.0
        target = np.arcsinh(ya[rows, column] / unit)
        network = _regression(
            xa[rows], target[:, None], hidden=16, seed=seed + 1, epochs=2 * epochs
        )
        held_x, held_y = [], []
        for k in range(3 if name == "short" else 1):
            column_k = _turn_labels(y, k)[:, column]
            chosen = ~fit & (column_k > 0.0)
            held_x.append(inputs(rotate(x[chosen], names, k)))
            held_y.append(np.arcsinh(column_k[chosen] / unit))
        predicted = network.build()(np.vstack(held_x))[:, 0]
        edges, widths = bin_widths(predicted, np.abs(np.concatenate(held_y) - predicted))
        found[name] = SeverityData(
            network=network, unit=unit, edges=edges, half_width=widths,
            upper=float(ya[rows, column].max()),
        )
    return found


def train_guard(
    known: np.ndarray, other: np.ndarray, names: list[str], kind: str, *, seed: int, epochs: int
) -> GuardData:
    """Return the guard: trained on `known`, bounded on `other` (squashed features)."""
    drivers = drivers_of(names, kind)
    checked = [n for n in names if n not in drivers and n not in NOT_CHECKED]
    d = [names.index(n) for n in drivers]
    c = [names.index(n) for n in checked]
    mean = _regression(known[:, d], known[:, c], hidden=32, seed=seed + 2, epochs=epochs)
    residual = np.abs(known[:, c] - mean.build()(known[:, d]))
    scale = _regression(
        known[:, d], np.log(residual + FLOOR), hidden=16, seed=seed + 3, epochs=epochs // 2
    )
    ratio = np.abs(other[:, c] - mean.build()(other[:, d])) / (
        np.exp(scale.build()(other[:, d])) + FLOOR
    )
    each = np.quantile(ratio, 0.995, axis=0)
    worst = (ratio / each).max(axis=1)
    limit = each * tail_quantile(worst, GUARD_RATE)
    return GuardData(drivers=drivers, checked=checked, mean=mean, scale=scale,
                     limit=limit.tolist())
