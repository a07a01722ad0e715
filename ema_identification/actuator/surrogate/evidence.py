"""All records of one unit together: residuals in units of the noise, tolerances in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from ema_identification.actuator.measure.runs import Runner, UnitRun
from ema_identification.actuator.measure.tolerances import PRIOR, RecordConditions, Tolerances
from ema_identification.actuator.surrogate.library import Library
from ema_record.record import Record
from ema_sim.effects import Effects

CARRIED = 0.15
"""Share of the misfit of the quadratic that is left after a run at the fitted tolerances."""
CARRIED_MOST = 0.5
"""The same for features whose misfit is large: limit cycles, which no slope describes."""
LARGE_MISFIT = (4.0, 12.0)
"""Misfit in units of a repeat from which, and at which, the second share holds."""
MODEL_ERROR = 0.02
"""Relative error of a prediction that contains a simulated effect."""
NOISE_ERROR = 0.04
"""Error of the noise factor that a record tells, in units of its regressor (a factor of two)."""
SLOPE_VARIANCE = 0.1
"""Variance of a slope of the library, of the variance about the quadratic, tails included."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordEvidence:
    """One record with what is known about records like it.

    Attributes
    ----------
    record : as measured.
    library : of its profile.
    conditions : as measured.
    values : its features, shape (d,).
    """

    record: Record
    library: Library
    conditions: RecordConditions
    values: np.ndarray
    _repeats: dict[int, np.ndarray] = field(
        init=False, repr=False, compare=False, default_factory=dict)

    def __len__(self) -> int:
        """Return the number of features."""
        return len(self.values)

    def repeat(self, runs: int) -> np.ndarray:
        """Return what `noise_covariance` is away from its diagonal, shape (d, d).

        It depends on the number of runs only and is kept, so it must not be changed.
        """
        if runs not in self._repeats:
            null, factor = self.library.null, self.library.scale.factor
            deviation = null.deviation(self.conditions.noise)
            covariance = null.correlation * np.outer(deviation, deviation)
            if runs:
                covariance *= 1.0 + 1.0 / runs
            covariance *= np.sqrt(np.outer(factor, factor))
            louder = null.noise_slope(self.conditions) * NOISE_ERROR
            covariance += np.outer(louder, louder)
            self._repeats[runs] = covariance
        return self._repeats[runs]


class Whitening:
    """Inverse root of a covariance of residuals."""

    def __init__(self, covariance: np.ndarray) -> None:
        # Of the transpose: LAPACK takes columns, and a symmetric matrix is then not copied twice.
        self._root, _ = cho_factor(covariance.T, lower=True, check_finite=False)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return `values`, shape (d,) or (d, m), in units of the noise."""
        return np.asarray(solve_triangular(self._root, values, lower=True, check_finite=False))

    def inverse(self, values: np.ndarray) -> np.ndarray:
        """Return the inverse covariance times `values`."""
        return np.asarray(cho_solve((self._root, True), values, check_finite=False))


def noise_covariance(
    block: RecordEvidence, *, runs: int, error: np.ndarray | None = None
) -> np.ndarray:
    """Return the covariance of measured minus simulated features at the true tolerances.

    Parameters
    ----------
    block : the record.
    runs : how many simulated runs the prediction is the mean of; 0: it is the quadratic's.
    error : ndarray, shape (d,). Standard deviation of a further error of each prediction.
    """
    null, factor = block.library.null, block.library.scale.factor
    deviation = null.deviation(block.conditions.noise)
    share: np.ndarray | float = 1.0
    if runs:
        low, high = LARGE_MISFIT
        large = np.clip((np.sqrt(null.misfit) / deviation - low) / (high - low), 0.0, 1.0)
        share = CARRIED + (CARRIED_MOST - CARRIED) * large
    extra = share**2 * null.misfit * factor
    if error is not None:
        extra = extra + error**2
    covariance = block.repeat(runs).copy()
    covariance[np.diag_indices_from(covariance)] += extra
    return covariance


class Asked(NamedTuple):
    """What is to be simulated: the mean of `runs` runs."""

    z: np.ndarray
    effects: Effects | None
    runs: int
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Records of one unit, and where runs on it are made."""

    blocks: tuple[RecordEvidence, ...]
    tolerances: Tolerances
    runner: Runner = field(repr=False, compare=False, default_factory=Runner)

    def mean(
        self, z: np.ndarray, effects: Effects | None, *, runs: int, seed: int
    ) -> list[np.ndarray]:
        """Return the mean simulated features of each record at tolerances `z`."""
        return self.means([Asked(z, effects, runs, seed)])[0]

    def means(self, asked: Sequence[Asked]) -> list[list[np.ndarray]]:
        """Return the mean simulated features of each record for all that is asked."""
        found: list[list[np.ndarray]] = [[] for _ in asked]
        ends = np.cumsum([a.runs for a in asked])[:-1]
        for k, block in enumerate(self.blocks):
            cases = [
                UnitRun(z=self.tolerances.of(k, a.z), conditions=block.conditions, seed=int(s),
                        effects=a.effects)
                for a in asked
                for s in np.random.default_rng([a.seed, 3, k]).integers(2**31, size=a.runs)
            ]
            if cases:
                values = self.runner.run(block.library.model, cases, block.library.fmap)
                for row, part in zip(found, np.split(values, ends)):
                    row.append(np.mean(part, axis=0))
        return found

    def slopes(self, z: np.ndarray) -> list[np.ndarray]:
        """Return the derivative of the features of each record to all tolerances."""
        return [
            self.tolerances.spread(k, block.library.null.slope(
                self.tolerances.of(k, z), block.conditions))
            for k, block in enumerate(self.blocks)
        ]

    def whitened(self, mean: Sequence[np.ndarray], runs: int) -> list[np.ndarray]:
        """Return measured less predicted features of each record, in standard deviations.

        `mean` is that of `runs` runs.
        """
        return [(b.values - f) / np.sqrt(np.diag(noise_covariance(b, runs=runs)))
                for b, f in zip(self.blocks, mean)]

    @property
    def size(self) -> int:
        """Number of features of all records."""
        return sum(len(b) for b in self.blocks)

    @property
    def usual(self) -> float:
        """Cost that a complete model leaves."""
        return sum(float(np.exp(b.library.scale.fit[0])) * len(b) for b in self.blocks)


def evidence(blocks: Sequence[RecordEvidence], runner: Runner | None = None) -> Evidence:
    """Return the evidence of `blocks`; runs are made by `runner`."""
    return Evidence(blocks=tuple(blocks), tolerances=Tolerances(len(blocks)),
                    runner=runner or Runner())


def slope_noise(block: RecordEvidence, covariance: np.ndarray) -> float:
    """Return the information that the errors of the library's slopes feign, a tolerance."""
    null = block.library.null
    error = SLOPE_VARIANCE * (null.misfit + 0.5 * null.deviation(1.0)**2)
    return float(np.sum(error / np.diag(covariance)))


def solve(
    columns: np.ndarray, target: np.ndarray, z: np.ndarray, free: int, feigned: float
) -> tuple[np.ndarray, np.ndarray]:
    """Least squares over `free` coordinates without prior and tolerances with theirs.

    Parameters
    ----------
    columns : ndarray, shape (d, free + tolerances), whitened.
    target : ndarray, shape (d,), whitened residual at `z`.
    z : ndarray, present tolerances.
    free : number of leading columns without a prior.
    feigned : information on each tolerance that only errors of the slopes make (`slope_noise`).

    Returns
    -------
    step : ndarray, shape (free + tolerances,).
    covariance : ndarray, of the step.
    """
    scale = np.maximum(np.sqrt((columns**2).sum(axis=0)), 1e-9)
    scale[free:] = 1.0
    scaled = columns / scale
    full = scaled.T @ scaled
    corrected = full.copy()
    corrected[range(free, len(scale)), range(free, len(scale))] -= feigned
    values, vectors = np.linalg.eigh(corrected)
    corrected = (vectors * np.maximum(values, 1e-12)) @ vectors.T
    prior = np.zeros(len(scale))
    prior[free:] = 1.0 / PRIOR**2
    pull = scaled.T @ target
    pull[free:] -= z / PRIOR**2
    # The step on what the slopes say, the covariance on what they really know.
    step = np.linalg.solve(full + np.diag(prior + 1e-9), pull)
    covariance = np.linalg.inv(corrected + np.diag(prior))
    return step / scale, covariance / np.outer(scale, scale)
