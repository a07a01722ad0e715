"""Training of the guard: what a known record looks like, and how far it may be off."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ema_prognostics.cascade.classes import KINDS_FOUND, TAIL_RATES
from ema_prognostics.cascade.guard import (
    ALONE,
    FLOOR,
    GROUP_SQUEEZE,
    LEAST_EXCESS,
    MEASURED,
    NO_FAULT_MOVES,
    checked_of,
    drivers_of,
    length,
    limits_of,
    signed,
    squeeze,
)
from ema_prognostics.cascade.guard_groups import group_columns
from ema_prognostics.cascade.model_body import (
    GroupPart,
    GuardPart,
    LimitPart,
    NetworkPart,
    rounded,
)
from ema_prognostics.networks.fitting import fit_regressor
from ema_prognostics.training.calibration import tail_quantile

GUARD_RATE, GROUP_RATE = 0.001, 0.0005
"""Rate of records that each of the guard's rules may turn away: all single features, all features
together, and each group of them."""
SHRINKAGE, LEAST_VARIANCE = 0.02, 0.05
"""Part of the variances added to the diagonal of the covariance; least variance of a residual,
which is 1 where its scatter is as the network says."""
MARGINS = {"healthy": 1.07, "slight": 1.15, "mechanical": 1.25, "electrical": 1.5, "both": 1.4}
"""On the limits of records with a fault, which few units set."""
WOUND = ("resistance_", "inductance_", "winding_")
WOUND_MARGIN, TAIL_MARGIN = 3.0, 1.3
"""Features that a short moves itself, with a further margin on their limits beside one; and one
everywhere, since equations of the voltages that are wrong give them long tails."""
PLAIN = 0.02
"""Rate down to which a quantile is that of the records themselves."""
SINGLE_RATE = 1e-4
"""Rate at which the checked features are made comparable, each by its own tail."""

WITHIN = {"slight": (0, 1), "mechanical": (1, 2), "electrical": (1, 3), "both": (1, 2, 3, 4)}
"""Kinds, of `KINDS_FOUND`, that set the limits of each: a record may hold less than is found."""


class GuardRecords(NamedTuple):
    """Squashed inputs, each shape (n, d), of the records that the guard is made of."""

    known: np.ndarray
    """With and without faults; they train it."""
    known_kind: np.ndarray
    """Of the known: which of `KINDS_FOUND`, shape (k,)."""
    weight: np.ndarray
    """Of the known, shape (k,)."""
    other: np.ndarray
    """Others of all known kinds; they set the limits."""
    kind: np.ndarray
    """Of the others: which of `KINDS_FOUND`, shape (n,)."""
    healthy: np.ndarray
    """Healthy ones; they set the limits of records without a fault."""


def _whitening(squeezed: np.ndarray) -> np.ndarray:
    """Return the matrix that makes `squeezed` residuals, shape (n, m), uncorrelated."""
    covariance = squeezed.T @ squeezed / len(squeezed)
    variance = np.diag(covariance)
    covariance += np.diag(SHRINKAGE * variance + np.maximum(LEAST_VARIANCE - variance, 0.0))
    return np.array(rounded(np.linalg.cholesky(np.linalg.inv(covariance)).T))


def _groups(known: np.ndarray, z: np.ndarray, checked: list[str], margin: float
            ) -> dict[str, GroupPart]:
    """Return the limits of the groups: scatter of `known` residuals, distance of those in `z`."""
    found = {}
    for name, columns in group_columns(tuple(checked)).items():
        whitening = _whitening(squeeze(known[:, columns], GROUP_SQUEEZE))
        distance = margin * tail_quantile(
            length(z[:, columns], whitening, GROUP_SQUEEZE), GROUP_RATE)
        found[name] = GroupPart(whitening=rounded(whitening), distance=float(f"{distance:.6g}"))
    return found


def _limits(
    known: np.ndarray, z: np.ndarray, checked: list[str], least: np.ndarray,
    margin: np.ndarray, all_margin: float,
) -> LimitPart:
    """Return the limits for a kind of record.

    Parameters
    ----------
    known : ndarray, shape (k, m). Scaled residuals of records that trained; their scatter.
    z : ndarray, shape (n, m). Those of others, which set the bounds.
    checked : names of the features, (m,).
    least : ndarray, shape (m,). No limit is below these.
    margin, all_margin : on the limits of the features, shape (m,), and on those of several.
    """
    whitening = _whitening(squeeze(known))
    each = np.array([max(tail_quantile(v, SINGLE_RATE), 1e-3) for v in np.abs(z).T])
    worst = (np.abs(z) / each).max(axis=1)
    limit = each * tail_quantile(worst, GUARD_RATE)
    distance = tail_quantile(length(z, whitening), GUARD_RATE)
    part = LimitPart(
        limit=rounded(margin * np.maximum(limit, least)), whitening=rounded(whitening),
        distance=float(f"{all_margin * distance:.6g}"), tail=[0.0] * len(TAIL_RATES),
        groups=_groups(known, z, checked, all_margin),
    )
    score = limits_of(part, checked).scores(z).max(axis=1)
    tail = np.maximum.accumulate([
        float(np.quantile(score, 1.0 - rate)) if rate >= PLAIN else tail_quantile(score, rate)
        for rate in TAIL_RATES])
    return part.model_copy(update={"tail": rounded(tail)})


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
    alone = np.isin(checked, ALONE)  # of these neither mean nor scatter depends on the drivers
    target = np.where(alone, np.median(known[:, c], axis=0), known[:, c])
    mean = fit_regressor(known[:, d], target, hidden=32, seed=seed + 2, iterations=iterations,
                         weight=records.weight)
    size = np.log(np.abs(known[:, c] - mean(known[:, d])) + FLOOR)
    scale = fit_regressor(known[:, d], np.where(alone, size.mean(axis=0), size), hidden=16,
                          seed=seed + 3, iterations=iterations // 2, decay=30.0,
                          weight=records.weight)

    def scatter(rows: np.ndarray) -> np.ndarray:
        return np.asarray(np.exp(scale(rows[:, d])) + FLOOR)

    def residuals(rows: np.ndarray) -> np.ndarray:
        z = (rows[:, c] - mean(rows[:, d])) / scatter(rows)
        return np.where(signed(checked), z, np.maximum(z, 0.0))

    def limits(first: np.ndarray, z: np.ndarray, found: str, least: np.ndarray) -> LimitPart:
        wound = WOUND_MARGIN if found in ("electrical", "both") else TAIL_MARGIN
        each = np.array([wound if n.startswith(WOUND) and n != NO_FAULT_MOVES else 1.0
                         for n in checked])
        return _limits(first, z, checked, least, MARGINS[found] * each, MARGINS[found])

    seen, other = residuals(known), residuals(records.other)
    excess = np.where(signed(checked), 1e-3, LEAST_EXCESS / np.median(scatter(known), axis=0))
    healthy = limits(seen[records.known_kind == 0], residuals(records.healthy), KINDS_FOUND[0],
                     excess)
    parts = {KINDS_FOUND[0]: healthy}
    for name, within in WITHIN.items():  # healthy records are of more units: no limit is below
        parts[name] = limits(seen[np.isin(records.known_kind, within)],
                             other[np.isin(records.kind, within)], name, np.array(healthy.limit))
    measured = {n: known[:, k] for k, n in enumerate(names) if n in MEASURED}
    return GuardPart(
        seen={n: (float(f"{v.min():.6g}"), float(f"{v.max():.6g}")) for n, v in measured.items()},
        drivers=drivers, checked=checked, mean=NetworkPart.of(mean), scale=NetworkPart.of(scale),
        limits=parts,  # type: ignore[arg-type]
    )
