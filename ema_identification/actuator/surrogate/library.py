"""What is known about records of one profile from one model: means, noise, signatures, scales.

`NullLibrary` says what effect-free runs look like, a quadratic in tolerances and conditions;
`Signature` what an effect adds, piecewise straight over its coordinates; `Scale` how far
recalibrated models are off when nothing is missing. `Library` holds all three.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.tolerances import N_TOLERANCES, RecordConditions
from ema_identification.actuator.surrogate.catalogue import Variant
from ema_record.record import Record
from ema_sim.model_file import Model


@dataclass(frozen=True, slots=True, kw_only=True)
class NullLibrary:
    """Statistics of runs without a missing effect.

    Attributes
    ----------
    weights : ndarray, shape (c, d). Of the columns of `design`.
    quiet, noisy : ndarrays, shape (d,). Variance of a repeat = quiet + noisy × (noise factor)².
    correlation : ndarray, shape (d, d). Of a repeat, shrunk.
    misfit : ndarray, shape (d,). Variance of the mean about the quadratic.
    """

    weights: np.ndarray
    quiet: np.ndarray
    noisy: np.ndarray
    correlation: np.ndarray
    misfit: np.ndarray

    def mean(self, z: np.ndarray, conditions: RecordConditions) -> np.ndarray:
        """Return the mean feature vector, shape (d,)."""
        return np.asarray(design(np.concatenate([z, conditions.regressors()])[None])[0]
                          @ self.weights)

    def slope(self, z: np.ndarray, conditions: RecordConditions) -> np.ndarray:
        """Return the derivative of the mean to the tolerances, shape (d, 18)."""
        v = np.concatenate([z, conditions.regressors()])
        step = 0.5 * np.eye(N_TOLERANCES, len(v))
        return np.asarray((design(v + step) - design(v - step)) @ self.weights).T

    def noise_slope(self, conditions: RecordConditions) -> np.ndarray:
        """Return the derivative of the mean to the regressor of the noise, shape (d,)."""
        v = np.concatenate([np.zeros(N_TOLERANCES), conditions.regressors()])
        step = np.zeros_like(v)
        step[-1] = 0.5
        return np.asarray((design((v + step)[None]) - design((v - step)[None]))[0] @ self.weights)

    def deviation(self, noise: float) -> np.ndarray:
        """Return the standard deviation of a repeat at a noise factor, shape (d,)."""
        return np.sqrt(self.quiet + self.noisy * min(max(noise, 0.3), 4.0)**2)


def design(v: np.ndarray) -> np.ndarray:
    """Return constant, linear, square and cross terms of `v`, shape (n, 21) -> (n, c)."""
    n, size = v.shape
    cross = [v[:, i] * v[:, j] for j in range(N_TOLERANCES, size) for i in range(j)]
    cross += [v[:, i] * v[:, j] for i in (2, 3, 4) for j in range(N_TOLERANCES)
              if j > i or j < 2]
    return np.column_stack([np.ones(n), v, v**2 - 1.0 / 3.0, *cross])


@dataclass(frozen=True, slots=True, kw_only=True)
class Signature:
    """Features that a variant adds, along each of its coordinates.

    Attributes
    ----------
    variant : what it is.
    levels : for each coordinate, sorted, with 0 among them.
    values : for each coordinate, ndarray of shape (levels, d).
    """

    variant: Variant
    levels: tuple[np.ndarray, ...]
    values: tuple[np.ndarray, ...]

    def at(self, u: np.ndarray) -> np.ndarray:
        """Return the added features at coordinates `u`, shape (d,)."""
        total = np.zeros(self.values[0].shape[1])
        for x, levels, values in zip(u, self.levels, self.values):
            total += self._along(float(x), levels, values)
        return total

    def slope(self, u: np.ndarray) -> np.ndarray:
        """Return the derivative to the coordinates, shape (d, size); zero where unknown."""
        found = np.zeros((self.values[0].shape[1], len(u)))
        for k, (x, levels, values) in enumerate(zip(u, self.levels, self.values)):
            if len(levels) > 1:
                place = _interval(float(x), levels)
                found[:, k] = (values[place + 1] - values[place]) / (
                    levels[place + 1] - levels[place])
        return found

    @staticmethod
    def _along(x: float, levels: np.ndarray, values: np.ndarray) -> np.ndarray:
        if len(levels) < 2:
            return np.zeros(values.shape[1])
        k = _interval(x, levels)
        part = (x - levels[k]) / (levels[k + 1] - levels[k])
        return np.asarray(values[k] + part * (values[k + 1] - values[k]))


def _interval(x: float, levels: np.ndarray) -> int:
    return int(np.clip(np.searchsorted(levels, x) - 1, 0, len(levels) - 2))


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """What residuals and scores look like when nothing is hidden (`calibration`).

    Attributes
    ----------
    factor : ndarray, shape (d,). On the variance of each feature.
    fit : mean and standard deviation of the logarithm of the cost a feature.
    gain : median of the best candidate's gain, and the scale of its exponential tail.
    """

    factor: np.ndarray
    fit: tuple[float, float] = (0.3, 0.25)
    gain: tuple[float, float] = (10.0, 5.0)

    def p_gain(self, gain: float) -> float:
        """Return the probability of a larger best gain when nothing is hidden."""
        return min(1.0, 0.5 * math.exp(min(1.0, -(gain - self.gain[0]) / self.gain[1])))

    def p_fit(self, cost_a_feature: float) -> float:
        """Return the probability of a larger cost when the model is complete."""
        x = (math.log(max(cost_a_feature, 1e-9)) - self.fit[0]) / self.fit[1]
        return 0.5 * math.erfc(x / math.sqrt(2.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Library:
    """Features, effect-free statistics and signatures for one model and profile."""

    model: Model
    fmap: FeatureMap
    null: NullLibrary
    signatures: tuple[Signature, ...]
    """Empty for a record that is only predicted."""
    scale: Scale
    example: Record
    """Any record of the profile."""
