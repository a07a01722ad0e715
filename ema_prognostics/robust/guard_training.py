"""Training of the guard: what a known record looks like, and how far it may be off."""

from __future__ import annotations

import numpy as np

from ema_prognostics.model_body import GuardPart, NetworkPart, rounded
from ema_prognostics.robust.calibration import tail_quantile
from ema_prognostics.robust.guard import FLOOR, NOT_CHECKED, drivers_of
from ema_prognostics.robust.networks import fit_regressor

GUARD_RATE = 0.0015
"""Rate of known records that the guard may turn away."""
TYPICAL = 0.995
"""Quantile to which the checked features are made comparable."""


def train_guard(
    known: np.ndarray, other: np.ndarray, names: list[str], kind: str, *, seed: int, epochs: int
) -> GuardPart:
    """Return the guard.

    Parameters
    ----------
    known : ndarray, shape (n, d). Squashed features that train it.
    other : ndarray, shape (m, d). Others, which set its limits.
    names : of the features, (d,).
    kind : of the test.
    seed, epochs : of the networks.
    """
    drivers = drivers_of(names, kind)
    checked = [n for n in names if n not in drivers and n not in NOT_CHECKED]
    d = [names.index(n) for n in drivers]
    c = [names.index(n) for n in checked]
    mean = fit_regressor(known[:, d], known[:, c], hidden=32, seed=seed + 2, epochs=epochs)
    residual = np.abs(known[:, c] - mean(known[:, d]))
    scale = fit_regressor(
        known[:, d], np.log(residual + FLOOR), hidden=16, seed=seed + 3, epochs=epochs // 2
    )
    ratio = np.abs(other[:, c] - mean(other[:, d])) / (np.exp(scale(other[:, d])) + FLOOR)
    each = np.quantile(ratio, TYPICAL, axis=0)
    worst = (ratio / each).max(axis=1)
    limit = each * tail_quantile(worst, GUARD_RATE)
    return GuardPart(
        drivers=drivers, checked=checked, mean=NetworkPart.of(mean), scale=NetworkPart.of(scale),
        limit=rounded(limit),
    )
