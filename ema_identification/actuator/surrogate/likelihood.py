"""How well a model explains the features: costs, and the tolerances that make them least.

The model without a new effect is recalibrated by least squares, its tolerances within their
bounds. Candidates are compared by one metric. A prediction that contains a simulated effect is off
by a share of what it adds. That share is taken of what the measurement differs from the model
before, so that costs of different candidates are sums of squares in one metric. While a fit is
still far from its end, differences from the model before are compared on a logarithmic scale
(`Metric.bend`): then an effect that moves a feature by hundreds of standard deviations pulls by
its relative error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import lsq_linear

from ema_identification.actuator.measure.tolerances import N_TOLERANCES
from ema_identification.actuator.surrogate.evidence import (
    MODEL_ERROR,
    Evidence,
    Whitening,
    noise_covariance,
    slope_noise,
    solve,
)


def bounded_least_squares(
    columns: np.ndarray, target: np.ndarray, low: np.ndarray, high: np.ndarray,
    weight: np.ndarray, centre: np.ndarray,
) -> np.ndarray:
    """Return the step within bounds that leaves least.

    Parameters
    ----------
    columns : ndarray, shape (d, m). Whitened slopes.
    target : ndarray, shape (d,). Whitened residual.
    low, high : ndarrays, shape (m,). Bounds of the step; low < high.
    weight : ndarray, shape (m,). Of the squares of ``centre + step``, added to the sum.
    centre : ndarray, shape (m,). Where the step begins.

    Returns
    -------
    ndarray, shape (m,).
    """
    root = np.sqrt(weight)
    rows, rest = np.vstack([columns, np.diag(root)]), np.append(target, -root * centre)
    scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-12)
    basis, triangle = np.linalg.qr(rows / scale)
    found = lsq_linear(triangle, basis.T @ rest, bounds=(low * scale, high * scale),
                       method="bvls")
    return np.clip(np.asarray(found.x) / scale, low, high)


ROUNDS = 3
"""Simulations at improved tolerances."""
RUNS = 3
"""Runs a simulation; the last has `LAST_RUNS`."""
LAST_RUNS = 12
COARSE = 0.2
"""Share of the residual granted as error in the first round; halves a round."""
BAND = 1.0
"""Bound of a tolerance (half widths)."""
WEIGHT = 1.0
"""Of the square of a tolerance in the cost: their bounds do the rest."""
TINY = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Recalibration:
    """The best that the model does without a new effect.

    Attributes
    ----------
    z : ndarray. Tolerances in half widths (`Evidence.tolerances`).
    centre : ndarray. Where `mean` was simulated.
    covariance : ndarray, of `z`.
    mean : simulated features of each record at `centre`.
    cost : sum of squares of the whitened residual, prior included.
    runs : of the last simulation.
    """

    z: np.ndarray
    centre: np.ndarray
    covariance: np.ndarray
    mean: tuple[np.ndarray, ...]
    cost: float
    runs: int

    @property
    def free(self) -> int:
        """Number of coordinates of effects: none."""
        return 0

    def predicted(self, evidence: Evidence) -> list[np.ndarray]:
        """Return the features of each record at `z`."""
        return [f + slope @ (self.z - self.centre)
                for f, slope in zip(self.mean, evidence.slopes(self.centre))]

    def whitened(self, evidence: Evidence) -> list[np.ndarray]:
        """Return what the model leaves of each record, in standard deviations."""
        return evidence.whitened(self.predicted(evidence), self.runs)


def recalibrate(
    evidence: Evidence, *, rounds: int = ROUNDS, runs: int = RUNS, last: int = LAST_RUNS,
    seed: int = 0,
) -> Recalibration:
    """Fit the tolerances: first on the library, then on runs at the fitted values."""
    z = np.zeros(evidence.tolerances.size)
    for _ in range(2):
        mean = [b.library.null.mean(evidence.tolerances.of(i, z), b.conditions)
                for i, b in enumerate(evidence.blocks)]
        z, _, _ = _recalibrated(evidence, z, mean, 0, COARSE)
    for k in range(rounds):
        n = last if k == rounds - 1 else runs
        mean = evidence.mean(z, None, runs=n, seed=seed + k)
        if k == rounds - 1:
            break
        z, _, _ = _recalibrated(evidence, z, mean, n, COARSE * 0.5**k)
    return recalibrated_at(evidence, z, mean, last)


def recalibrated_at(
    evidence: Evidence, centre: np.ndarray, mean: list[np.ndarray], runs: int
) -> Recalibration:
    """Return the recalibration that follows from one simulation at tolerances `centre`."""
    z, covariance, cost = _recalibrated(evidence, centre, mean, runs, 0.0)
    return Recalibration(z=z, centre=centre, covariance=covariance, mean=tuple(mean), cost=cost,
                         runs=runs)


def _recalibrated(
    evidence: Evidence, z: np.ndarray, mean: list[np.ndarray], runs: int, coarse: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return tolerances within their bands, their covariance and the cost."""
    rows, target, feigned = [], [], 0.0
    for block, f, slope in zip(evidence.blocks, mean, evidence.slopes(z)):
        noise = noise_covariance(block, runs=runs, error=coarse * (block.values - f))
        feigned += slope_noise(block, noise)
        white = Whitening(noise)
        rows.append(white(slope))
        target.append(white(block.values - f))
    columns, rest = np.vstack(rows), np.concatenate(target)
    _, covariance = solve(columns, rest, z, 0, feigned)
    step = bounded_least_squares(
        columns, rest, -BAND - z - TINY, BAND - z + TINY, np.full(len(z), WEIGHT), z)
    rest = rest - columns @ step
    found = np.clip(z + step, -BAND, BAND)
    return found, covariance, float(rest @ rest + WEIGHT * (found @ found))


ASTRAY = 30.0
"""Cost a feature from which the recalibrated model is no better reference than the nominal one."""
BEND = 5.0
"""Standard deviations from which differences are compared on a logarithmic scale."""
BENT_ERROR = 0.1
"""Relative error on that scale."""
KEPT = 3
"""Metrics that are kept: a step is judged by the one of the point before and its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """Whitening of the residual of each record.

    Attributes
    ----------
    white : one a record.
    before : features of each record without what is missing.
    unit : standard deviation of each feature, a record.
    bend : where the scale becomes logarithmic (standard deviations); inf: nowhere.
    feigned : information on each tolerance that errors of the library's slopes feign.
    runs : of the predictions that are judged.
    """

    white: tuple[Whitening, ...]
    before: tuple[np.ndarray, ...]
    unit: tuple[np.ndarray, ...]
    bend: float
    feigned: float
    runs: int

    def bent(self, record: int, features: np.ndarray) -> np.ndarray:
        """Return features on the scale of the metric, shape (d,) or (d, m) as given."""
        shape = (-1,) + (1,) * (features.ndim - 1)
        x = features - self.before[record].reshape(shape)
        if np.isinf(self.bend):
            return np.asarray(x)
        knee = self.bend * self.unit[record].reshape(shape)
        return np.asarray(knee * np.arcsinh(x / knee))

    def flattening(self, record: int, features: np.ndarray) -> np.ndarray:
        """Return the derivative of `bent`, shape (d,)."""
        if np.isinf(self.bend):
            return np.ones(len(features))
        x = (features - self.before[record]) / (self.bend * self.unit[record])
        return np.asarray(1.0 / np.sqrt(1.0 + x**2))

    def residual(self, evidence: Evidence, mean: Sequence[np.ndarray]) -> np.ndarray:
        """Return measured minus predicted features, whitened, shape (d,)."""
        return np.concatenate([
            white(self.bent(k, b.values) - self.bent(k, f))
            for k, (white, b, f) in enumerate(zip(self.white, evidence.blocks, mean))])

    def columns(
        self, evidence: Evidence, slopes: np.ndarray, mean: Sequence[np.ndarray]
    ) -> np.ndarray:
        """Return slopes of the stacked features about `mean`, whitened, shape (d, m)."""
        parts = np.split(slopes, np.cumsum([len(b) for b in evidence.blocks])[:-1])
        return np.vstack([
            white(self.flattening(k, f)[:, None] * part)
            for k, (white, part, f) in enumerate(zip(self.white, parts, mean))])

    def cost(self, evidence: Evidence, mean: Sequence[np.ndarray], z: np.ndarray) -> float:
        """Return the sum of squares, that of the tolerances included."""
        rest = self.residual(evidence, mean)
        return float(rest @ rest + WEIGHT * (z @ z))


def metric(
    evidence: Evidence, before: Sequence[np.ndarray], *, runs: int, error: float = MODEL_ERROR,
    bend: float = np.inf, slope: np.ndarray | None = None, loose: bool = False,
) -> Metric:
    """Return the metric for predictions that are means of `runs` runs.

    Parameters
    ----------
    evidence : the records.
    before : features of each record without what is missing (`reference`).
    runs : of a prediction; 0 for one of the library.
    error : relative, of what a candidate adds.
    bend : see `Metric`.
    slope : ndarray, shape (d, tolerances), or None. Of tolerances that are integrated out.
    loose : whether features that no slope describes (limit cycles) count little.
    """
    white, units, feigned, at = [], [], 0.0, 0
    for block, f in zip(evidence.blocks, before):
        added = block.values - f
        plain = noise_covariance(block, runs=0 if loose else runs)
        unit = np.sqrt(np.diag(plain))
        noise = plain
        if np.isinf(bend):
            noise = noise_covariance(block, runs=runs, error=error * added)
            flat = np.ones(len(f))
        else:
            flat = 1.0 / np.sqrt(1.0 + (added / (bend * unit))**2)
            noise = plain * np.outer(flat, flat)
            noise[np.diag_indices_from(noise)] += (
                error * bend * unit * np.arcsinh(np.abs(added) / (bend * unit)))**2 + (
                0.1 * unit)**2
        feigned += slope_noise(block, noise)
        if slope is not None:
            own = flat[:, None] * slope[at:at + len(f)]
            noise = noise + own @ own.T / 3.0
        at += len(f)
        white.append(Whitening(noise))
        units.append(unit)
    return Metric(white=tuple(white), before=tuple(np.asarray(f) for f in before),
                  unit=tuple(units), bend=bend, feigned=feigned, runs=runs)


def reference(
    evidence: Evidence, recalibrated: Sequence[np.ndarray], cost: float
) -> list[np.ndarray]:
    """Return the features without what is missing, as well as they are known.

    Those of the recalibrated model, but of the nominal one where a large effect led the
    recalibration astray.
    """
    if cost < ASTRAY * evidence.size:
        return list(recalibrated)
    return nominal(evidence)


def nominal(evidence: Evidence) -> list[np.ndarray]:
    """Return the features of the nominal unit under the conditions of each record."""
    return [b.library.null.mean(np.zeros(N_TOLERANCES), b.conditions) for b in evidence.blocks]


@dataclass(frozen=True, slots=True, kw_only=True)
class Robust:
    """A metric in which no single feature counts for more than 1 / share².

    A feature that is off by much is one that the model of the noise does not describe (the phase
    of a limit cycle), or one on which the effect in question acts hard; a few of those must not
    decide where a fit goes.

    Attributes
    ----------
    before : features of each record without what is missing (`reference`).
    runs : of the predictions that are judged.
    share : of a residual that is granted as its error.
    scatter : standard deviation of a further error of each feature of each record.
    """

    before: tuple[np.ndarray, ...]
    runs: int
    share: float
    scatter: tuple[np.ndarray, ...] = ()
    _known: list[tuple[Evidence, tuple[np.ndarray, ...], Metric]] = field(
        init=False, repr=False, compare=False, default_factory=list)

    def at(self, evidence: Evidence, mean: Sequence[np.ndarray]) -> Metric:
        """Return the metric about a prediction; the latest few are kept."""
        for at, features, known in self._known:
            if at is evidence and all(a is b for a, b in zip(features, mean)):
                return known
        self._known.append((evidence, tuple(mean), self._at(evidence, mean)))
        del self._known[:-KEPT]
        return self._known[-1][2]

    def _at(self, evidence: Evidence, mean: Sequence[np.ndarray]) -> Metric:
        white, feigned = [], 0.0
        scatter = self.scatter or tuple(np.zeros_like(f) for f in mean)
        for block, f0, f, more in zip(evidence.blocks, self.before, mean, scatter):
            noise = noise_covariance(block, runs=self.runs, error=np.hypot(np.hypot(
                MODEL_ERROR * (block.values - f0), self.share * (block.values - f)), more))
            feigned += slope_noise(block, noise)
            white.append(Whitening(noise))
        return Metric(white=tuple(white), before=self.before, unit=self.before, bend=np.inf,
                      feigned=feigned, runs=self.runs)

    def cost(self, evidence: Evidence, mean: Sequence[np.ndarray], z: np.ndarray) -> float:
        """Return the bounded sum of squares, that of the tolerances included."""
        return self.at(evidence, mean).cost(evidence, mean, z)
