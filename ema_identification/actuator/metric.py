"""Distance between measured and predicted features, the same for all candidates of a unit.

A prediction that contains a simulated effect is off by a share of what it adds. That share is
taken of what the measurement differs from the model before, so that costs of different candidates
are sums of squares in one metric and can be compared. While a fit is still far from its end,
differences from the model before are compared on a logarithmic scale (`bend`): then an effect
that moves a feature by hundreds of standard deviations pulls by its relative error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ema_identification.actuator.evidence import (
    MODEL_ERROR,
    Evidence,
    Whitening,
    noise_covariance,
    slope_noise,
)
from ema_identification.actuator.recalibration import WEIGHT
from ema_identification.actuator.spread import N_TOLERANCES

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
