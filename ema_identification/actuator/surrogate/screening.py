"""Screen: which signatures of the catalogue explain the residual, tolerances left free."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from ema_identification.actuator.measure.tolerances import PRIOR
from ema_identification.actuator.surrogate.catalogue import Variant
from ema_identification.actuator.surrogate.evidence import Evidence, Whitening, noise_covariance
from ema_identification.actuator.surrogate.likelihood import (
    BAND,
    TINY,
    WEIGHT,
    bounded_least_squares,
)
from ema_identification.actuator.surrogate.signatures import Signature

LIBRARY_ERROR = 0.1
"""Error of a signature of the library, of the residual that it is to explain."""
SWEEPS = 4
"""Passes over the coordinates of a variant with several."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Residual:
    """What the recalibrated model leaves, in units of the noise, tolerances integrated out.

    Attributes
    ----------
    target : ndarray, shape (d,). Whitened.
    white : the whitening, of stacked features of all records.
    slope : ndarray, shape (d, tolerances).
    raw : ndarray, shape (d,). Not whitened, at tolerances 0.
    """

    target: np.ndarray
    white: Whitening
    slope: np.ndarray
    raw: np.ndarray

    def tolerances(self, signature: np.ndarray) -> np.ndarray:
        """Return the tolerances that go best with an effect of this signature, shape (d,)."""
        return np.clip(PRIOR**2 * (self.slope.T @ self.white.inverse(self.raw - signature)),
                       -1.5, 1.5)

    @property
    def cost(self) -> float:
        """Sum of squares without an effect."""
        return float(self.target @ self.target)


@dataclass(frozen=True, slots=True, kw_only=True)
class Screened:
    """A variant with the coordinates at which its signature fits best."""

    variant: Variant
    index: int
    """In the libraries' signatures."""
    u: np.ndarray
    cost: float
    """Sum of squares left."""
    z: np.ndarray
    """Tolerances that go with it."""
    own: Signature | None = None
    """Signature of all records, stacked, where it is not in the libraries."""


def residual(
    evidence: Evidence, centre: np.ndarray, mean: Sequence[np.ndarray], *, runs: int,
    free: Sequence[np.ndarray] = (), error: float = LIBRARY_ERROR,
    scatter: Sequence[np.ndarray] | None = None,
) -> Residual:
    """Return the residual about runs at tolerances `centre` with features `mean`.

    Parameters
    ----------
    evidence : the records.
    centre : tolerances at which `mean` was simulated.
    mean : features of each record.
    runs : how many runs `mean` is the mean of; 0 for the library's quadratic.
    error : relative, of what is to explain the residual; without it a few features on which an
        effect acts hard would decide alone.
    scatter : standard deviation of a further error of each feature of each record.
    free : columns, shape (d,) each (stacked), whose amount is free (of an effect found before).
    """
    slopes = evidence.slopes(centre)
    covariance = block_diag(*(
        noise_covariance(b, runs=runs, error=np.hypot(error * (b.values - f), s))
        for b, f, s in zip(evidence.blocks, mean, scatter or [np.zeros_like(f) for f in mean])))
    slope = np.vstack(slopes)
    covariance += PRIOR**2 * (slope @ slope.T)
    for column in free:
        covariance += 1e4 * np.outer(column, column)
    white = Whitening(covariance)
    target = np.concatenate([b.values - f for b, f in zip(evidence.blocks, mean)])
    raw = target + slope @ centre
    return Residual(target=white(raw), white=white, slope=slope, raw=raw)


def stacked(evidence: Evidence, index: int) -> Signature:
    """Return signature `index` of all records, features one after another."""
    found = [b.library.signatures[index] for b in evidence.blocks]
    if len(found) == 1:
        return found[0]
    first = found[0]
    levels, values = [], []
    for k in range(first.variant.size):
        common = np.unique(np.concatenate([s.levels[k] for s in found]))
        levels.append(common)
        rows = []
        for x in common:
            parts = []
            for s in found:
                u = np.zeros(first.variant.size)
                u[k] = x
                parts.append(s.at(u))
            rows.append(np.concatenate(parts))
        values.append(np.array(rows))
    return Signature(variant=first.variant, levels=tuple(levels), values=tuple(values))


def signature_of(evidence: Evidence, screened: Screened) -> Signature:
    """Return the signature of a screened variant, of all records."""
    return stacked(evidence, screened.index) if screened.own is None else screened.own


def screen_catalogue(
    evidence: Evidence, rest: Residual, *, without: Iterable[str] = ()
) -> list[Screened]:
    """Return all variants with their best coordinates, best first."""
    return sorted((best_of(stacked(evidence, index), index, rest)
                   for index in selectable(evidence, without)), key=lambda s: s.cost)


def selectable(evidence: Evidence, without: Iterable[str]) -> list[int]:
    """Return the signatures that may be named: not hidden, not of a measured condition."""
    hidden = set(without)
    measured = frozenset.union(*(b.conditions.measured for b in evidence.blocks))
    return [
        index for index, s in enumerate(evidence.blocks[0].library.signatures)
        if s.variant.effect not in hidden and s.variant.condition not in measured
    ]


def best_of(signature: Signature, index: int, rest: Residual) -> Screened:
    """Return a variant at the coordinates at which it leaves least of the residual."""
    white = [rest.white(values.T).T for values in signature.values]
    u = np.zeros(signature.variant.size)
    parts = [np.zeros_like(rest.target) for _ in u]
    left = rest.target.copy()
    cost = rest.cost
    for _ in range(SWEEPS if len(u) > 1 else 1):
        for k, (levels, values) in enumerate(zip(signature.levels, white)):
            if len(levels) < 2:
                continue
            without = left + parts[k]
            u[k], parts[k], cost = _along(levels, values, without)
            left = without - parts[k]
    return Screened(variant=signature.variant, index=index, u=u, cost=cost,
                    z=rest.tolerances(signature.at(u)))


def _along(
    levels: np.ndarray, values: np.ndarray, target: np.ndarray
) -> tuple[float, np.ndarray, float]:
    """Return the point on a piecewise straight curve that comes nearest to `target`."""
    start, end = values[:-1], values[1:]
    edge = end - start
    length = np.maximum((edge**2).sum(axis=1), 1e-30)
    part = np.clip(((target - start) * edge).sum(axis=1) / length, 0.0, 1.0)
    points = start + part[:, None] * edge
    cost = ((target - points)**2).sum(axis=1)
    k = int(np.argmin(cost))
    x = levels[k] + part[k] * (levels[k + 1] - levels[k])
    return float(x), points[k], float(cost[k])


def bounded_gains(
    evidence: Evidence, centre: np.ndarray, mean: Sequence[np.ndarray], runs: int,
    screened: Sequence[Screened],
) -> list[float]:
    """Return by how much each variant lowers the cost, tolerances held within their bands.

    In units of the cost a feature that it leaves. A tolerance that would have to leave its band
    to imitate an effect is no explanation.
    """
    rules = [Whitening(noise_covariance(b, runs=runs, error=LIBRARY_ERROR * (b.values - f)))
             for b, f in zip(evidence.blocks, mean)]
    ends = np.cumsum([len(b) for b in evidence.blocks])[:-1]

    def white(rows: np.ndarray) -> np.ndarray:
        return np.concatenate([w(part) for w, part in zip(rules, np.split(rows, ends))])

    slopes = white(np.vstack(evidence.slopes(centre)))
    rest = white(np.concatenate([b.values - f for b, f in zip(evidence.blocks, mean)]))
    n = len(centre)

    def cost_of(columns: np.ndarray, target: np.ndarray, low: np.ndarray, high: np.ndarray
                ) -> float:
        free = columns.shape[1] - n
        weight = np.concatenate([np.zeros(free), np.full(n, WEIGHT)])
        begin = np.concatenate([np.zeros(free), centre])
        step = bounded_least_squares(
            columns, target, np.concatenate([low, -BAND - TINY - centre]),
            np.concatenate([high, BAND + TINY - centre]), weight, begin)
        left = target - columns @ step
        return float(left @ left + weight @ (begin + step)**2)

    nothing = cost_of(slopes, rest, np.zeros(0), np.zeros(0))
    gains = []
    for s in screened:
        signature = signature_of(evidence, s)
        own = white(np.column_stack([signature.at(s.u), signature.slope(s.u)]))
        low, high = np.array(s.variant.low) - s.u, np.array(s.variant.high) - s.u
        left = cost_of(np.hstack([own[:, 1:], slopes]), rest - own[:, 0],
                       np.minimum(low, -1e-9), np.maximum(high, 1e-9))
        gains.append((nothing - left) / max(left / evidence.size, 1e-9))
    return gains
