"""Training of the guard: what a known record looks like, and how far it may be off."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ema_prognostics.model_body import GuardPart, LimitPart, NetworkPart, rounded
from ema_prognostics.network import Network, logit
from ema_prognostics.robust.calibration import tail_quantile
from ema_prognostics.robust.guard import FLOOR, checked_of, drivers_of, squeeze
from ema_prognostics.robust.networks import fit_classifier, fit_regressor

GUARD_RATE = 0.001
"""Rate of records that each of the guard's rules may turn away."""
STRANGER_RATE = 0.002
"""Rate of records that the network which knows strangers may turn away."""
SHRINKAGE = 0.02
"""Part of the variances added to the diagonal of the covariance."""
TYPICAL = 0.995
"""Quantile to which the checked features are made comparable."""


class GuardRecords(NamedTuple):
    """Squashed features, each shape (n, d), of the records that the guard is made of."""

    known: np.ndarray
    """With and without faults; they train it."""
    other: np.ndarray
    """Others of all known kinds; they set the limits."""
    healthy: np.ndarray
    """Healthy ones; they set the limits of records without a fault."""
    strangers: np.ndarray
    """With effects that are no class of ours."""


def _limits(z: np.ndarray, stranger: Network) -> LimitPart:
    """Return the limits for a kind of record.

    Parameters
    ----------
    z : ndarray, shape (n, m). Scaled residuals, in no order: one half gives the covariance,
        the other the bound of the distance.
    stranger : the network that knows strangers.
    """
    half = len(z) // 2
    first, second = squeeze(z[:half]), squeeze(z[half:])
    covariance = first.T @ first / half
    covariance += SHRINKAGE * np.diag(np.diag(covariance)) + 1e-6 * np.eye(z.shape[1])
    whitening = np.linalg.cholesky(np.linalg.inv(covariance)).T
    length = np.linalg.norm(second @ whitening.T, axis=1)
    each = np.maximum(np.quantile(np.abs(z), TYPICAL, axis=0), 1e-3)
    worst = (np.abs(z) / each).max(axis=1)
    strange = logit(stranger(squeeze(z))[:, 0])
    return LimitPart(
        limit=rounded(each * tail_quantile(worst, GUARD_RATE)), whitening=rounded(whitening),
        distance=float(f"{tail_quantile(length, GUARD_RATE):.6g}"),
        stranger=float(f"{tail_quantile(strange, STRANGER_RATE):.6g}"),
    )


def train_guard(
    records: GuardRecords, names: list[str], kind: str, *, seed: int, epochs: int
) -> GuardPart:
    """Return the guard.

    Parameters
    ----------
    records : squashed features.
    names : of the features, (d,).
    kind : of the test.
    seed, epochs : of the networks.
    """
    drivers, checked = drivers_of(names, kind), checked_of(names, kind)
    d = [names.index(n) for n in drivers]
    c = [names.index(n) for n in checked]
    known = records.known
    mean = fit_regressor(known[:, d], known[:, c], hidden=32, seed=seed + 2, epochs=epochs)
    residual = known[:, c] - mean(known[:, d])
    scale = fit_regressor(
        known[:, d], np.log(np.abs(residual) + FLOOR), hidden=16, seed=seed + 3,
        epochs=epochs // 2,
    )
    rng = np.random.default_rng(seed)

    def scaled(rows: np.ndarray) -> np.ndarray:
        rows = rows[rng.permutation(len(rows))]
        return (rows[:, c] - mean(rows[:, d])) / (np.exp(scale(rows[:, d])) + FLOOR)

    parts = [squeeze(scaled(rows)) for rows in (known, records.strangers)]
    part = NetworkPart.of(fit_classifier(
        np.vstack(parts), np.repeat([False, True], [len(p) for p in parts]), hidden=12,
        epochs=epochs, seed=seed + 4,
    ))
    network = part.build()
    return GuardPart(
        drivers=drivers, checked=checked, mean=NetworkPart.of(mean), scale=NetworkPart.of(scale),
        stranger=part, known=_limits(scaled(records.other), network),
        healthy=_limits(scaled(records.healthy), network),
    )
