"""Training of the guard: what a known record looks like, and how far it may be off."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ema_prognostics.model_body import GuardPart, LimitPart, NetworkPart, rounded
from ema_prognostics.robust.calibration import tail_quantile
from ema_prognostics.robust.guard import FLOOR, Limits, checked_of, drivers_of, signed, squeeze
from ema_prognostics.robust.known import KINDS_FOUND, TAIL_RATES
from ema_prognostics.robust.networks import fit_regressor

GUARD_RATE = 0.001
"""Rate of records that each of the guard's rules may turn away."""
SHRINKAGE = 0.02
"""Part of the variances added to the diagonal of the covariance."""
MARGINS = {"healthy": 1.05, "mechanical": 1.1, "electrical": 1.25, "both": 1.25}
"""On the limits of records with a fault, which few units set."""
WOUND = ("resistance_", "inductance_", "winding_")
WOUND_MARGIN, TAIL_MARGIN = 3.0, 1.3
"""Features that a short moves itself, with a further margin on their limits beside one; and one
everywhere, since equations of the voltages that are wrong give them long tails."""
PLAIN = 0.02
"""Rate down to which a quantile is that of the records themselves."""
SINGLE_RATE = 1e-4
"""Rate at which the checked features are made comparable, each by its own tail."""


class GuardRecords(NamedTuple):
    """Squashed inputs, each shape (n, d), of the records that the guard is made of."""

    known: np.ndarray
    """With and without faults; they train it."""
    other: np.ndarray
    """Others of all known kinds; they set the limits."""
    kind: np.ndarray
    """Of the others: which of `KINDS_FOUND`, shape (n,)."""
    healthy: np.ndarray
    """Healthy ones; they set the limits of records without a fault."""


def _limits(
    z: np.ndarray, least: LimitPart | None, margin: np.ndarray, all_margin: float
) -> LimitPart:
    """Return the limits for a kind of record.

    Parameters
    ----------
    z : ndarray, shape (n, m). Scaled residuals, in no order: one half gives the covariance,
        the other the bound of the distance.
    least : of healthy records, of which there are more units: no limit is below these; None
        for the healthy ones themselves.
    margin, all_margin : on the limits of the features, shape (m,), and on that of all together.
    """
    half = len(z) // 2
    first, second = squeeze(z[:half]), squeeze(z[half:])
    covariance = first.T @ first / half
    covariance += SHRINKAGE * np.diag(np.diag(covariance)) + 1e-6 * np.eye(z.shape[1])
    whitening = np.linalg.cholesky(np.linalg.inv(covariance)).T
    length = np.linalg.norm(second @ whitening.T, axis=1)
    each = np.array([max(tail_quantile(v, SINGLE_RATE), 1e-3) for v in np.abs(z).T])
    worst = (np.abs(z) / each).max(axis=1)
    limit, distance = each * tail_quantile(worst, GUARD_RATE), tail_quantile(length, GUARD_RATE)
    if least is not None:
        limit = np.maximum(limit, least.limit)
    found = Limits(margin * limit, whitening, all_margin * distance, np.zeros(len(TAIL_RATES)))
    score = found.scores(z[half:]).max(axis=1)
    tail = np.maximum.accumulate([
        float(np.quantile(score, 1.0 - rate)) if rate >= PLAIN else tail_quantile(score, rate)
        for rate in TAIL_RATES])
    return LimitPart(
        limit=rounded(found.limit), whitening=rounded(whitening),
        distance=float(f"{found.distance:.6g}"), tail=rounded(tail),
    )


def train_guard(
    records: GuardRecords, names: list[str], kind: str, *, seed: int, iterations: int
) -> GuardPart:
    """Return the guard.

    It learns from healthy records and from those of our classes alone; what else may befall an
    actuator it never sees.

    Parameters
    ----------
    records : squashed inputs.
    names : of the inputs, (d,).
    kind : of the test.
    seed, iterations : of the networks.
    """
    drivers, checked = drivers_of(names, kind), checked_of(names, kind)
    d = [names.index(n) for n in drivers]
    c = [names.index(n) for n in checked]
    known = records.known
    mean = fit_regressor(known[:, d], known[:, c], hidden=32, seed=seed + 2, iterations=iterations)
    residual = known[:, c] - mean(known[:, d])
    scale = fit_regressor(
        known[:, d], np.log(np.abs(residual) + FLOOR), hidden=16, seed=seed + 3,
        iterations=iterations // 2, decay=30.0,
    )
    rng = np.random.default_rng(seed)

    def limits(rows: np.ndarray, found: str, least: LimitPart | None = None) -> LimitPart:
        rows = rows[rng.permutation(len(rows))]
        z = (rows[:, c] - mean(rows[:, d])) / (np.exp(scale(rows[:, d])) + FLOOR)
        z = np.where(signed(checked), z, np.maximum(z, 0.0))
        margin = MARGINS.get(found, 1.0)
        wound = WOUND_MARGIN if found in ("electrical", "both") else TAIL_MARGIN
        each = np.array([wound if n.startswith(WOUND) else 1.0 for n in checked])
        return _limits(z, least, margin * each, margin)

    # A record may hold less than is found in it, so each kind counts with those within it.
    within = {k: [m for m in range(len(KINDS_FOUND)) if m & k == m]
              for k in range(len(KINDS_FOUND))}
    healthy = limits(records.healthy, KINDS_FOUND[0])
    parts = {name: limits(records.other[np.isin(records.kind, within[k])], name, healthy)
             for k, name in enumerate(KINDS_FOUND) if k > 0}
    parts[KINDS_FOUND[0]] = healthy
    return GuardPart(
        drivers=drivers, checked=checked, mean=NetworkPart.of(mean), scale=NetworkPart.of(scale),
        limits=parts,  # type: ignore[arg-type]
    )
