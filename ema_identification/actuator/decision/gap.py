"""Gap on a held-out record: what a fitted model leaves of a test that took no part in the fit.

What belongs to the day (load, errors of the current sensors) is fitted to the held-out record;
all else is predicted. One yardstick for all models: what the model without a law may be off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.decision.fit import PRIOR, LawFit, TestedUnit
from ema_identification.actuator.decision.fleet import NAMES, SIZE
from ema_identification.actuator.naming.gap import worst

RUNS, DRAWS = 8, 99
"""Of a prediction; of the last model's own, whose ranks resolve the level of the decision."""
OF_DAY = np.array([n.startswith(("current_sensor", "surface_load")) for n in NAMES])
"""What differs from test to test."""


class LawGap(NamedTuple):
    """The gap of models on one record.

    Attributes
    ----------
    values : of each model.
    draws : ndarray, shape (n,). The same when runs of the last model are measured.
    """

    values: tuple[float, ...]
    draws: np.ndarray

    @property
    def floor(self) -> float:
        """What the last model's own runs leave, the median."""
        return float(np.median(self.draws)) if len(self.draws) else float("nan")

    @property
    def bound(self) -> float:
        """What 95 % of them stay within."""
        return float(np.sort(self.draws)[int(0.95 * (len(self.draws) + 1)) - 1]) if len(
            self.draws) else float("nan")


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """A held-out record of the unit of `fitted`."""

    unit: TestedUnit
    fitted: TestedUnit

    @cached_property
    def _covariance(self) -> np.ndarray:
        """Return that of the fitted tolerances, shape (SIZE, SIZE); of the day: their band."""
        null = self.fitted.without_law()
        columns = self.fitted.whitener(0).columns(null.slopes, self.fitted.values - null.mean)
        found = np.linalg.inv(columns.T @ columns + PRIOR * np.eye(SIZE))
        found[OF_DAY] = found[:, OF_DAY] = 0.0
        return found

    def gap(self, models: Sequence[LawFit]) -> LawGap:
        """Return the gap of each model, the first without a law."""
        z = [np.where(OF_DAY, 0.0, np.clip(m.z, -1.0, 1.0)) for m in models]
        slope = self.unit.library.slope(z[0], self.unit.conditions)
        root = np.sqrt(np.diag(self.unit.covariance(RUNS)) + np.einsum(
            "ij,jk,ik->i", slope, self._covariance, slope))
        day = slope[:, OF_DAY] / root[:, None]
        solve = np.linalg.inv(day.T @ day + PRIOR * np.eye(day.shape[1])) @ day.T
        means = [self.unit.run(m.terms, x, RUNS, salt=21) for m, x in zip(models, z)]

        def left(values: np.ndarray) -> list[float]:
            parts = []
            for mean in means:
                rest = (values - mean) / root
                parts.append([rest - day @ np.clip(solve @ rest, -1.0, 1.0)])
            return worst(parts)

        rng = np.random.default_rng([self.unit.seed, 23])
        draws = []
        for k in range(DRAWS):
            there = rng.multivariate_normal(z[-1], self._covariance)
            there[OF_DAY] = rng.uniform(-1.0, 1.0, int(OF_DAY.sum()))
            run = self.unit.run(models[-1].terms, np.clip(there, -1.0, 1.0), 1, salt=100 + k)
            if np.isfinite(run).all():
                draws.append(left(run)[-1])
        return LawGap(values=tuple(left(self.unit.values)), draws=np.array(draws))
