"""What effect-free runs look like: mean over tolerances and conditions, and repeatability.

Units are drawn from the fleet, each is run twice with other noise. The mean of the pairs gives
the dependence of the features on tolerances and conditions (quadratic, ridge); the differences
give the covariance of a repeat, which grows with the noise of the sensors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ema_identification.actuator.features import FeatureMap
from ema_identification.actuator.runs import Case, Progress, run_cases, silent
from ema_identification.actuator.spread import (
    N_TOLERANCES,
    Conditions,
    draw_conditions,
    draw_tolerances,
)
from ema_sim.actuator import Model

UNITS = 450
"""Units of a library; each is run twice."""
RIDGE = 1.0
SHRINK = 0.3
"""Share of the identity in the correlation of a repeat."""
FLOORS = {"position_step": 0.05, "speed_step": 0.05, "bus_slope": 2e-3}
"""Least standard deviation of features that repeat exactly."""
FLOOR = 2e-4
"""Least standard deviation of any feature, of its root mean square."""


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

    def mean(self, z: np.ndarray, conditions: Conditions) -> np.ndarray:
        """Return the mean feature vector, shape (d,)."""
        return np.asarray(design(np.concatenate([z, conditions.regressors()])[None])[0]
                          @ self.weights)

    def slope(self, z: np.ndarray, conditions: Conditions) -> np.ndarray:
        """Return the derivative of the mean to the tolerances, shape (d, 18)."""
        v = np.concatenate([z, conditions.regressors()])
        step = 0.5 * np.eye(N_TOLERANCES, len(v))
        return np.asarray((design(v + step) - design(v - step)) @ self.weights).T

    def noise_slope(self, conditions: Conditions) -> np.ndarray:
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


def build_null_library(
    model: Model, fmap: FeatureMap, *, seed: int = 0, workers: int = 1,
    progress: Progress = silent, units: int | None = None,
) -> NullLibrary:
    """Simulate the units and return their statistics."""
    cases: list[Case] = []
    for k in range(UNITS if units is None else units):
        rng = np.random.default_rng([seed, 1, k])
        case = Case(z=draw_tolerances(rng), conditions=draw_conditions(rng),
                    seed=int(rng.integers(2**31)))
        cases += [case, replace(case, seed=int(rng.integers(2**31)))]
    found = run_cases(model, cases, fmap, workers=workers, progress=progress,
                      what="effect-free runs")
    first, second = found[0::2], found[1::2]
    good = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    pairs = [c for c, g in zip(cases[0::2], good) if g]
    v = np.array([np.concatenate([c.z, c.conditions.regressors()]) for c in pairs])
    noise = np.array([c.conditions.noise for c in pairs])
    mean, difference = 0.5 * (first + second)[good], ((first - second) / np.sqrt(2.0))[good]
    columns = design(v)
    penalty = RIDGE * np.eye(columns.shape[1])
    penalty[0, 0] = 0.0
    weights = np.linalg.solve(columns.T @ columns + penalty, columns.T @ mean)
    floor = (FLOOR * np.sqrt((mean**2).mean(axis=0)) + 1e-6)**2
    for k, feature in enumerate(fmap.features):
        floor[k] = max(floor[k], FLOORS.get(feature.name, 0.0)**2)
    quiet, noisy = _noise_law(difference, noise)
    quiet = np.maximum(quiet, floor)
    scaled = difference / np.sqrt(quiet + noisy * noise[:, None]**2)
    correlation = np.clip(scaled, -6.0, 6.0).T @ np.clip(scaled, -6.0, 6.0) / len(scaled)
    root = np.sqrt(np.maximum(np.diag(correlation), 1e-3))
    correlation = (1.0 - SHRINK) * correlation / np.outer(root, root)
    np.fill_diagonal(correlation, 1.0)
    rest = mean - columns @ weights
    freedom = max(1, len(mean) - columns.shape[1])
    misfit = (rest**2).sum(axis=0) / freedom - 0.5 * (difference**2).mean(axis=0)
    return NullLibrary(weights=weights, quiet=quiet, noisy=noisy, correlation=correlation,
                       misfit=np.maximum(misfit, 0.0))


def _noise_law(difference: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a, b >= 0 of variance = a + b noise², from a quiet and a noisy half."""
    half = noise < np.median(noise)
    low, high = (difference[half]**2).mean(axis=0), (difference[~half]**2).mean(axis=0)
    n_low, n_high = float((noise[half]**2).mean()), float((noise[~half]**2).mean())
    slope = np.clip((high - low) / (n_high - n_low), 0.0, high / n_high)
    return np.maximum(high - slope * n_high, 0.0), slope
