"""What records of one test look like over the healthy fleet: mean, spread, repeats, laws.

The mean is a quadratic in everything in which healthy units and days differ; what it leaves of
units that it was not fitted to is the noise of its predictions, measured (leave one out). Pairs
of runs of one unit give the part of that noise which no model can take away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls
from scipy.stats import chi2

from ema_identification.actuator.fleet.units import FleetRuns, LibrarySizes, of_day, unit_numbers
from ema_identification.actuator.laws.catalogue import Signature
from ema_identification.actuator.laws.terms import SURE
from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.tolerances import NOISES, RecordConditions, conditions_of
from ema_record.spread import TypeSpread
from ema_sim.model_file import Model

BEND = 5.0
"""Standard deviations from which residuals count by their logarithm: the noise there is not
known."""
RIDGES = (0.3, 3.0, 30.0, 300.0)
"""Penalties tried for each feature; leave one out chooses."""
FACTORS = (1.0, 30.0)
"""Times larger is the penalty of second-order terms, of which most are nothing."""
SETTLED_RUNS = 8
"""Of a model in the end, healthy or not."""
LOUDEST = 4.0
"""Noise factor up to which the law of the noise is believed."""
WORST = 0.1
"""Part of the features that the gap looks at: most effects show in few."""
LARGEST_RESIDUAL = 1e4
"""Most that one feature counts (standard deviations)."""
FLOORS = {"position_step": 0.05, "speed_step": 0.05, "bus_slope": 2e-3}
"""Least standard deviation of features that repeat exactly."""
FLOOR = 2e-4
"""Least standard deviation of any feature, of its root mean square."""


def design(v: np.ndarray) -> np.ndarray:
    """Return constant, linear and all second-order terms of `v`, shape (n, m) -> (n, c)."""
    one, other = np.triu_indices(v.shape[1])
    return np.hstack([np.ones((len(v), 1)), v, v[:, one] * v[:, other]
                      - np.where(one == other, 1.0 / 3.0, 0.0)])


def arguments(z: np.ndarray, conditions: RecordConditions) -> np.ndarray:
    """Return the row that `design` takes: a unit and the measured conditions of its day."""
    return np.append(z, conditions.regressors())


def bent(x: np.ndarray) -> np.ndarray:
    """Return standardised residuals on the scale on which they are compared."""
    return np.asarray(BEND * np.arcsinh(x / BEND))


def flattening(x: np.ndarray) -> np.ndarray:
    """Return the derivative of `bent`."""
    return np.asarray(1.0 / np.sqrt(1.0 + (x / BEND) ** 2))


@dataclass(frozen=True, kw_only=True)
class Whitener:
    """Residuals to independent numbers of variance 1; `straight`: without `bent`."""

    deviation: np.ndarray
    root: np.ndarray
    straight: bool = False

    def residual(self, rest: np.ndarray) -> np.ndarray:
        """Return measured minus predicted features, shape (d,) or (d, m), whitened."""
        scale = self.deviation.reshape((-1,) + (1,) * (rest.ndim - 1))
        return self._white(rest / scale if self.straight else bent(rest / scale))

    def bent(self, rest: np.ndarray) -> np.ndarray:
        """Return residuals, shape (d,), standardised and bent, with their correlation."""
        return bent(rest / self.deviation)

    def columns(self, slopes: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """Return slopes, shape (d, m), as `residual` sees them about `rest`."""
        return self.system(slopes, rest)[:, :-1]

    def system(self, slopes: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """Return `columns` and, as the last one, `residual` of `rest`: one solution for both."""
        x = rest / self.deviation
        flat, last = (1.0, x) if self.straight else (flattening(x), bent(x))
        return self._white(np.column_stack([(flat / self.deviation)[:, None] * slopes, last]))

    def _white(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(solve_triangular(self.root, x, lower=True, check_finite=False))


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseLaw:
    """Covariance of a residual: deviations that grow with the sensors' noise, a correlation.

    Attributes
    ----------
    quiet, noisy : ndarrays, shapes (d,), (2, d). Variance = quiet + Σ noisy × (noise factor)².
    correlation : ndarray, shape (d, d). Shrunk as Ledoit and Wolf (2004) estimate.
    """

    quiet: np.ndarray
    noisy: np.ndarray
    correlation: np.ndarray

    def covariance(self, noise: Sequence[float]) -> np.ndarray:
        """Return the covariance at noise factors, shape (d, d)."""
        deviation = self.deviation(noise)
        return np.asarray(self.correlation * np.outer(deviation, deviation))

    def deviation(self, noise: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return the standard deviations, shape (..., d), at noise factors, shape (..., 2)."""
        return np.sqrt(self.quiet + np.minimum(noise, LOUDEST) ** 2 @ self.noisy)

    def scaled(self, factor: float) -> NoiseLaw:
        """Return the law with all variances times `factor`."""
        return NoiseLaw(quiet=factor * self.quiet, noisy=factor * self.noisy,
                        correlation=self.correlation)


def shrunk(x: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the covariance of rows about zero, times 1 - s, and s (Ledoit and Wolf 2004).

    As scikit-learn's, which takes longer to load than a record without an effect to judge.
    """
    found = x.T @ x / len(x)
    power = float((found**2).sum())
    apart = max(power - float(np.trace(found)) ** 2 / len(found), 0.0)  # from a multiple of one
    error = (float(((x**2).sum(axis=1) ** 2).mean()) - power) / len(x)
    share = min(max(error, 0.0), apart) / max(apart, 1e-300)
    return (1.0 - share) * found, share


def excess(rows: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return by how much features of runs of one model vary more than by noise, shape (d,).

    Zero up to what Gaussian noise alone would reach in no feature of `SURE` of the records.

    Parameters
    ----------
    rows : ndarray, shape (n, d). Of runs with noise of their own.
    noise : ndarray, shape (d,). Variance that is expected.
    """
    own, free = rows.var(axis=0, ddof=1), len(rows) - 1
    most = chi2.isf((1.0 - SURE) / len(noise), free) / free
    return np.where(own > most * noise, own - noise, 0.0)


def noise_law(rest: np.ndarray, noise: np.ndarray, floor: np.ndarray) -> NoiseLaw:
    """Return the law of residuals of many records.

    Parameters
    ----------
    rest : ndarray, shape (n, d).
    noise : ndarray, shape (n, 2). Noise factors of each record.
    floor : ndarray, shape (d,). Least variance of each feature.
    """
    parts = np.column_stack([np.ones(len(noise)), noise**2])
    q, r = np.linalg.qr(parts)  # the same least squares, of three rows
    found = np.array([nnls(r, row)[0] for row in (rest**2).T @ q])
    quiet, slope = np.maximum(found[:, 0], floor), found[:, 1:].T
    x = bent(rest / np.sqrt(quiet + noise**2 @ slope))
    x /= np.maximum(np.sqrt((x**2).mean(axis=0)), 1e-9)  # a feature may be constant
    correlation, _ = shrunk(x)
    np.fill_diagonal(correlation, 1.0)
    return NoiseLaw(quiet=quiet, noisy=slope, correlation=correlation)


def mended(
    slopes: np.ndarray, step: np.ndarray, change: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Return slopes, shape (d, m), that say what a step did (Broyden), coordinates by `scale`."""
    weight = step / scale**2
    power = float(step @ weight)
    if power < 1e-4:
        return slopes
    return slopes + np.outer(change - slopes @ step, weight) / power


def worst(residual: Sequence[np.ndarray]) -> list[float]:
    """Return the rms of each model over the tenth of features in which the worst is off most."""
    squares = np.clip(np.array(residual), -LARGEST_RESIDUAL, LARGEST_RESIDUAL)**2
    count = max(1, round(WORST * squares.shape[1]))
    chosen = np.argsort(squares.max(axis=0))[-count:]
    return [float(np.sqrt(row[chosen].mean())) for row in squares]


def least_size(signature: Signature) -> float:
    """Return the least size at which a law was simulated."""
    found = [float(np.abs(x[x != 0.0]).min()) for x in signature.levels if len(x) > 1]
    return min(found, default=1.0)


class Discrepancy(NamedTuple):
    """What healthy machines leave over the model, feature by feature: mean, spread, shape (d,)."""

    mean: np.ndarray
    spread: np.ndarray
    """Standard deviation between units, and the error of the mean."""


@dataclass(frozen=True, kw_only=True)
class FleetLibrary:
    """What is known of the records of one type and one test.

    Attributes
    ----------
    model, spread : the type, and how its healthy units differ.
    fmap : the features of the test.
    weights : ndarray, shape (c, d). Of `design`.
    surrogate : noise of a prediction of the quadratic.
    repeat : noise of a single run.
    signatures : what each variant of the catalogue adds on the middle of the fleet; may be empty.
    carried : share of the quadratic's error that is left after runs at the unit's own parameters.
    healthy : ndarray, shape (n, 4). `proposals.Scores` of units that built nothing of this, on the
        quadratic.
    aside : conditions, shape (n, 5), and features, shape (n, d), of the same units.
    left : discrepancy of the type, where acceptance records tell it.
    """

    model: Model
    spread: TypeSpread
    fmap: FeatureMap
    weights: np.ndarray
    surrogate: NoiseLaw
    repeat: NoiseLaw
    signatures: tuple[Signature, ...] = ()
    carried: float = 1.0
    healthy: np.ndarray
    aside: tuple[np.ndarray, np.ndarray]
    left: Discrepancy | None = None

    def means(self, z: np.ndarray, conditions: RecordConditions) -> np.ndarray:
        """Return the mean features of several units, shape (n, width) -> (n, d)."""
        rows = np.hstack([z, np.tile(conditions.regressors(), (len(z), 1))])
        left = 0.0 if self.left is None else self.left.mean
        return np.asarray(design(rows) @ self.weights + left)

    def slope(self, z: np.ndarray, conditions: RecordConditions) -> np.ndarray:
        """Return their derivative to `z`, shape (d, width): exact, of a quadratic."""
        row = np.append(1.0, arguments(z, conditions))
        return np.asarray((row @ self._bends).reshape(len(z), -1)).T

    @cached_property
    def _bends(self) -> np.ndarray:
        """Weights of the derivative to each number of the unit, shape (1 + m, width × d)."""
        n = self.width
        m = n + len(RecordConditions().regressors())
        upper, place = np.triu_indices(m), np.zeros((m, m), dtype=int)
        place[upper] = place.T[upper] = 1 + m + np.arange(len(upper[0]))
        found = self.weights[np.column_stack([1 + np.arange(n), place[:n]])]
        found[np.arange(n), 1 + np.arange(n)] *= 2.0
        return np.ascontiguousarray(found.swapaxes(0, 1)).reshape(1 + m, -1)

    @cached_property
    def width(self) -> int:
        """Numbers of a unit on some day."""
        return len(unit_numbers(self.model.actuator))

    @cached_property
    def of_day(self) -> np.ndarray:
        """Return which of them differ from test to test, shape (width,), bool."""
        return of_day(self.width)

    @cached_property
    def root(self) -> np.ndarray:
        """Return the lower root of the correlation of the quadratic's errors, shape (d, d)."""
        return np.asarray(cholesky(self.surrogate.correlation, lower=True))

    @cached_property
    def freedom(self) -> float:
        """Independent numbers in a record, as the scatter of the healthy costs tells."""
        return float(2.0 / np.var(np.log(self.healthy[:, 0])))


def fit_mean(v: np.ndarray, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights of the quadratic and its residuals, each unit left out once.

    Parameters
    ----------
    v : ndarray, shape (n, m), rows of `arguments`.
    features : ndarray, shape (n, d).
    """
    columns = design(v)
    spread = columns.std(axis=0)
    spread[0] = 1.0
    middle = features.mean(axis=0)
    best = np.full(features.shape[1], np.inf)
    weights = np.zeros((columns.shape[1], features.shape[1]))
    rest = np.zeros_like(features)
    for factor in FACTORS:
        scale = spread * np.where(np.arange(len(spread)) > v.shape[1], np.sqrt(factor), 1.0)
        u, s, vt = np.linalg.svd(columns / scale, full_matrices=False)
        projected = u.T @ (features - middle)
        for ridge in RIDGES:
            shrunk = s**2 / (s**2 + ridge)
            leverage = (u**2 * shrunk).sum(axis=1)
            left = features - middle - u @ (shrunk[:, None] * projected)
            left /= (1.0 - leverage)[:, None]
            error = (left**2).mean(axis=0)
            better = error < best
            best = np.where(better, error, best)
            rest[:, better] = left[:, better]
            found = vt.T @ ((shrunk / s)[:, None] * projected[:, better])
            weights[:, better] = found / scale[:, None]
    weights[0] += middle
    return weights, rest


def fitted_library(
    runs: FleetRuns, model: Model, spread: TypeSpread, fmap: FeatureMap, sizes: LibrarySizes,
    signatures: tuple[Signature, ...] = (),
) -> FleetLibrary:
    """Return the library of runs, not judged yet."""
    good = np.isfinite(runs.features).all(axis=1)
    good[sizes.units:] = False
    v = np.array([arguments(z, conditions_of(c))
                  for z, c in zip(runs.z[good], runs.conditions[good])])
    features, noise = runs.features[good], runs.conditions[:, NOISES]
    floor = (FLOOR * np.sqrt((features**2).mean(axis=0)) + 1e-6) ** 2
    for k, feature in enumerate(fmap.features):
        floor[k] = max(floor[k], FLOORS.get(feature.name, 0.0) ** 2)
    weights, rest = fit_mean(v, features)
    paired = np.isfinite(runs.again).all(axis=1) & good[:len(runs.again)]
    difference = (runs.features[:len(runs.again)] - runs.again)[paired] / np.sqrt(2.0)
    return FleetLibrary(
        model=model, spread=spread, fmap=fmap, weights=weights, signatures=signatures,
        surrogate=noise_law(rest, noise[good], floor),
        repeat=noise_law(difference, noise[:len(runs.again)][paired], 0.5 * floor),
        healthy=np.ones((1, 4)),
        aside=(runs.conditions[sizes.ranked:], runs.features[sizes.ranked:]))
