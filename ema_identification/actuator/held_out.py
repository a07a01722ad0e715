"""Show: the gap on data that took no part in the fit, before and after.

The number is the root mean square of the largest tenth of the features' residuals, in standard
deviations of what the model may be off when nothing is missing: most effects show in few features,
and a mean over all would hide them. With held-out records the model is run on their commands.
Without, each tenth of the features is predicted from a fit to the other nine.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.evidence import (
    Asked,
    Evidence,
    noise_covariance,
    solve,
)
from ema_identification.actuator.fit import Fit
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.tolerances import SHARED
from ema_sim.effects import Effects

RUNS = 8
"""Runs of a held-out command."""
FOLDS = 10
"""Folds of the cross-validation; neighbouring features are in different ones."""
WORST = 0.1
"""Part of the features that the gap looks at."""
FLOOR = 2.2
"""The gap of a record against itself when nothing is missing; 2.1 for a normal distribution."""
DRAWS = 9
"""Runs of the model against itself that give the floor of a held-out command."""
LARGEST = 1e4
"""Most that one feature counts (standard deviations)."""


class Gap(NamedTuple):
    """A gap and where it comes from."""

    value: float
    floor: float
    residual: tuple[np.ndarray, ...]
    """Of each held-out record, in standard deviations."""


def _worst(parts: list[np.ndarray]) -> float:
    squares = np.sort(np.clip(np.concatenate(parts), -LARGEST, LARGEST)**2)
    return float(np.sqrt(np.mean(squares[-max(1, round(WORST * len(squares))):])))


def gap_of(
    evidence: Evidence, held: Evidence | None, fit: Fit | Recalibration,
    effects: Effects | None, *, seed: int,
) -> Gap:
    """Return the gap of a fitted model.

    Parameters
    ----------
    evidence : the records of the fit.
    held : held-out records; None predicts each tenth of the features from the
        others.
    fit : the fit.
    effects : of the model, None for its own.
    seed : of the runs on held-out records.
    """
    if held is None:
        parts = cross_validated(evidence, fit)
        return Gap(_worst(parts), FLOOR, tuple(parts))
    at = _Prediction(evidence, held, fit, effects, seed)
    parts = at.residual([b.values for b in held.blocks])
    return Gap(_worst(parts), at.floor(seed), tuple(parts))


class _Prediction:
    """Held-out records as predicted with the tolerances of the fit.

    What belongs to the day (the load) is fitted to the held-out record itself.
    """

    def __init__(
        self, evidence: Evidence, held: Evidence, fit: Fit | Recalibration,
        effects: Effects | None, seed: int,
    ) -> None:
        n = int(SHARED.sum())
        self.held, self.effects = held, effects
        self.z = np.zeros(held.tolerances.size)
        self.z[:n] = evidence.tolerances.of(0, fit.z)[SHARED]
        free = fit.free
        self.known = fit.covariance[free:free + n, free:free + n]
        self.mean = held.mean(self.z, effects, runs=RUNS, seed=seed + 100)

    def residual(self, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return measured minus predicted features in standard deviations, a record."""
        parts = []
        for k, block in enumerate(self.held.blocks):
            slope = block.library.null.slope(self.held.tolerances.of(k, self.z), block.conditions)
            variance = np.diag(noise_covariance(block, runs=RUNS)).copy()
            own, shared = slope[:, ~SHARED], slope[:, SHARED]
            variance += np.einsum("ij,jk,ik->i", shared, self.known, shared)
            root = np.sqrt(variance)
            residual = values[k] - self.mean[k]
            day, *_ = np.linalg.lstsq(
                np.vstack([own / root[:, None], np.eye(own.shape[1]) * np.sqrt(3.0)]),
                np.concatenate([residual / root, np.zeros(own.shape[1])]), rcond=None)
            parts.append((residual - own @ np.clip(day, -1.5, 1.5)) / root)
        return parts

    def floor(self, seed: int) -> float:
        """Return the gap of the model against itself.

        Its tolerances are drawn from what the fit leaves open, the noise is another. So the floor
        holds what the command at hand makes of a small error of the tolerances.
        """
        rng = np.random.default_rng([seed, 6])
        n = len(self.known)
        asked = []
        for k in range(DRAWS):
            z = self.z.copy()
            z[:n] = np.clip(rng.multivariate_normal(z[:n], self.known), -1.0, 1.0)
            z[n:] = rng.uniform(-1.0, 1.0, len(z) - n)
            asked.append(Asked(z, self.effects, 1, seed + 200 + k))
        found = [_worst(self.residual(values)) for values in self.held.means(asked)
                 if all(np.isfinite(f).all() for f in values)]
        return float(np.median(found)) if found else FLOOR


def cross_validated(evidence: Evidence, fit: Fit | Recalibration) -> list[np.ndarray]:
    """Return the residuals of each tenth of the features, predicted from a fit to the others."""
    if isinstance(fit, Fit):
        columns, centre = fit.slopes, fit.z
        residual = np.concatenate([b.values - f for b, f in zip(evidence.blocks, fit.mean)])
    else:
        columns, centre = np.vstack(evidence.slopes(fit.centre)), fit.centre
        residual = np.concatenate([b.values - f for b, f in zip(evidence.blocks, fit.mean)])
    noise = [noise_covariance(b, runs=fit.runs) for b in evidence.blocks]
    root = np.sqrt(np.concatenate([np.diag(c) for c in noise]))
    fold = np.arange(len(columns)) % FOLDS
    scaled, target = columns / root[:, None], residual / root
    found = np.empty(len(target))
    for k in range(FOLDS):
        inside = fold == k
        step, covariance, _ = solve(
            scaled[~inside], target[~inside], centre, fit.free, 0.0)
        rest = target[inside] - scaled[inside] @ step
        extra = np.einsum("ij,jk,ik->i", scaled[inside], covariance, scaled[inside])
        found[inside] = rest / np.sqrt(1.0 + extra)
    ends = np.cumsum([len(b) for b in evidence.blocks])
    return np.split(found, ends[:-1])


def whitened(evidence: Evidence, fit: Fit | Recalibration) -> list[np.ndarray]:
    """Return the residual of the fit in standard deviations, a record."""
    if isinstance(fit, Fit):
        means = list(fit.mean)
    else:
        means = [f + slope @ (fit.z - fit.centre)
                 for f, slope in zip(fit.mean, evidence.slopes(fit.centre))]
    return [(b.values - f) / np.sqrt(np.diag(noise_covariance(b, runs=fit.runs)))
            for b, f in zip(evidence.blocks, means)]
