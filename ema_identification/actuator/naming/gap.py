"""The gap of the model as given and after each effect, and what noise alone leaves.

The number is the root mean square of a tenth of the features' residuals: most effects show in few
features, and a mean over all would hide them. The yardstick is fixed before anything is added: the
standard deviation of each feature when nothing is missing, as the recalibrated model as given has
it. The features are the same for all models that are compared: those in which the worst of them is
off most. With held-out records the models are run on their commands; they take no part in any
fit and decide no name. Without, the numbers are those of the fitted records.

What noise alone leaves is found by putting runs of the last model in the place of the measurement;
for held-out records its parameters are drawn from what the fit leaves open.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.actuator.measure.tolerances import SHARED
from ema_identification.actuator.surrogate.evidence import Asked, Evidence, noise_covariance, solve
from ema_identification.actuator.surrogate.fit import Fit, coordinates, moved, with_terms
from ema_identification.actuator.surrogate.likelihood import Recalibration

GAP_RUNS = 8
"""Runs of a model on a held-out command."""
WORST = 0.1
"""Part of the features that the gap looks at."""
DRAWS = 39
"""Runs in place of the measurement: the least number whose rank tells a level of 0.025."""
LEVEL = 0.05
"""Part of the model's own runs that leave more than the bound of the noise."""
LARGEST_RESIDUAL = 1e4
"""Most that one feature counts (standard deviations)."""
DAY = 1.5
"""Largest deviation of the day (the load) that is fitted to a held-out record (half widths)."""

Model = Fit | Recalibration


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelGap:
    """The gap of the model as given and after each effect, in the order found.

    Attributes
    ----------
    values : of the model as given first.
    draws : ndarray, shape (n, models). The same numbers where runs of the last model stand in the
        place of the measurement.
    residual : of each model, of each record: ndarray, shape (d,), standard deviations.
    held : whether the records took no part in the fit.
    """

    values: tuple[float, ...]
    draws: np.ndarray
    residual: tuple[tuple[np.ndarray, ...], ...]
    held: bool

    @property
    def floor(self) -> float:
        """What noise alone leaves: the median of the draws."""
        return float(np.median(self.draws[:, -1])) if len(self.draws) else float("nan")

    @property
    def p_value(self) -> float:
        """Probability that noise alone leaves as much as the last model: its rank."""
        return float(1 + np.sum(self.draws[:, -1] >= self.values[-1])) / (1 + len(self.draws))

    @property
    def bound(self) -> float:
        """What noise alone leaves at most, in 95 % of all cases: a draw, by its rank."""
        n = len(self.draws)
        if not n:
            return float("nan")
        return float(np.sort(self.draws[:, -1])[min(math.ceil((1.0 - LEVEL) * (n + 1)), n) - 1])


def gap_of(
    evidence: Evidence, held: Evidence | None, null: Recalibration, fits: Sequence[Fit], *,
    seed: int,
) -> ModelGap:
    """Return the gap of the model as given and of fits that add one effect after another.

    Parameters
    ----------
    evidence : the records of the fit.
    held : held-out records; None shows the gap on those of the fit.
    null : the recalibrated model as given; it gives the yardstick.
    fits : after each effect, in the order found.
    seed : of the runs.
    """
    models: list[Model] = [null, *fits]
    shown = _Fitted(evidence, null) if held is None else _HeldOut(evidence, held, null)
    measured = [b.values for b in shown.evidence.blocks]
    means = [shown.predicted(m, seed) for m in models]

    def left(values: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
        return [shown.residual(m, mean, values) for m, mean in zip(models, means)]

    residual = left(measured)
    draws = [worst(left(values)) for values in shown.evidence.means(shown.asked(models[-1], seed))
             if all(np.isfinite(f).all() for f in values)]
    return ModelGap(values=tuple(worst(residual)), held=held is not None,
                    draws=np.array(draws).reshape(-1, len(models)),
                    residual=tuple(tuple(r) for r in residual))


def worst(residual: Sequence[Sequence[np.ndarray]]) -> list[float]:
    """Return the rms of each model over the tenth of features in which the worst is off most."""
    squares = np.array([np.clip(np.concatenate(list(r)), -LARGEST_RESIDUAL, LARGEST_RESIDUAL)**2
                        for r in residual])
    count = max(1, round(WORST * squares.shape[1]))
    chosen = np.argsort(squares.max(axis=0))[-count:]
    return [float(np.sqrt(row[chosen].mean())) for row in squares]


class _Fitted:
    """The gap on the records of the fit: residuals after a last linear step of all unknowns."""

    def __init__(self, evidence: Evidence, null: Recalibration) -> None:
        self.evidence = evidence
        self._root = np.sqrt(np.concatenate([
            np.diag(noise_covariance(b, runs=null.runs)) for b in evidence.blocks]))
        self._ends = np.cumsum([len(b) for b in evidence.blocks])[:-1]

    def predicted(self, model: Model, _seed: int) -> list[np.ndarray]:
        return list(model.mean)

    def residual(
        self, model: Model, mean: Sequence[np.ndarray], values: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        target = np.concatenate([v - f for v, f in zip(values, mean)]) / self._root
        slopes, z = (model.slopes, model.z) if isinstance(model, Fit) else (
            np.vstack(self.evidence.slopes(model.centre)), model.centre)
        columns = slopes / self._root[:, None]
        step, _ = solve(columns, target, z, model.free, 0.0)
        return np.split(target - columns @ step, self._ends)

    def asked(self, model: Model, seed: int) -> list[Asked]:
        effects = model.effects(self.evidence.blocks[0].library.model.effects) if isinstance(
            model, Fit) else None
        z = np.clip(model.z, -1.0, 1.0)
        return [Asked(z, effects, 1, seed + 200 + k) for k in range(DRAWS)]


class _HeldOut:
    """The gap on held-out records, predicted with the tolerances of the fit.

    What belongs to the day (the load) is fitted to the held-out record itself.
    """

    def __init__(self, evidence: Evidence, held: Evidence, null: Recalibration) -> None:
        self.evidence, self._fitted = held, evidence
        n = int(SHARED.sum())
        z, known = self._tolerances(null), null.covariance[:n, :n]
        self._roots, self._days = [], []
        for k, block in enumerate(held.blocks):
            slope = block.library.null.slope(held.tolerances.of(k, z), block.conditions)
            own, shared = slope[:, ~SHARED], slope[:, SHARED]
            variance = np.diag(noise_covariance(block, runs=GAP_RUNS)) + np.einsum(
                "ij,jk,ik->i", shared, known, shared)
            self._roots.append(np.sqrt(variance))
            self._days.append(own / np.sqrt(variance)[:, None])

    def _tolerances(self, model: Model) -> np.ndarray:
        z = np.zeros(self.evidence.tolerances.size)
        z[:int(SHARED.sum())] = self._fitted.tolerances.of(0, model.z)[SHARED]
        return z

    def predicted(self, model: Model, seed: int) -> list[np.ndarray]:
        base = self.evidence.blocks[0].library.model.effects
        effects = model.effects(base) if isinstance(model, Fit) else base
        return self.evidence.mean(
            self._tolerances(model), effects, runs=GAP_RUNS, seed=seed + 100)

    def residual(
        self, _model: Model, mean: Sequence[np.ndarray], values: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        parts = []
        for root, own, v, f in zip(self._roots, self._days, values, mean):
            target = (v - f) / root
            weight = np.sqrt(3.0) * np.eye(own.shape[1])  # of the load's uniform band
            day, *_ = np.linalg.lstsq(
                np.vstack([own, weight]), np.append(target, np.zeros(own.shape[1])), rcond=None)
            parts.append(target - own @ np.clip(day, -DAY, DAY))
        return parts

    def asked(self, model: Model, seed: int) -> list[Asked]:
        """Return runs with effects and tolerances drawn from what the fit leaves open."""
        rng = np.random.default_rng([seed, 6])
        terms = model.terms if isinstance(model, Fit) else ()
        u = coordinates(terms) if terms else np.zeros(0)
        base, n = self.evidence.blocks[0].library.model.effects, int(SHARED.sum())
        z, size = self._tolerances(model), len(u) + int(SHARED.sum())
        found = []
        for k in range(DRAWS):
            drawn = rng.multivariate_normal(np.append(u, z[:n]), model.covariance[:size, :size])
            there = np.append(np.clip(drawn[len(u):], -1.0, 1.0),
                              rng.uniform(-1.0, 1.0, len(z) - n))
            effects = with_terms(moved(terms, drawn[:len(u)]), base)
            found.append(Asked(there, effects, 1, seed + 200 + k))
        return found
