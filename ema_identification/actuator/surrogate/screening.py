"""Screen the catalogue: which signatures explain what a model leaves, tolerances left free.

About the recalibrated unit this is linear and sharp for small effects (`screen_catalogue`). A
large effect is not a small one scaled up: `Sizing` compares signatures about the nominal unit at
each of their sizes, with differences on a logarithmic scale and the tolerances integrated out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from ema_identification.actuator.measure.tolerances import PRIOR
from ema_identification.actuator.surrogate.catalogue import Variant
from ema_identification.actuator.surrogate.evidence import Evidence, Whitening, noise_covariance
from ema_identification.actuator.surrogate.fit import Fit
from ema_identification.actuator.surrogate.library import Signature
from ema_identification.actuator.surrogate.likelihood import (
    BAND,
    BEND,
    BENT_ERROR,
    TINY,
    WEIGHT,
    Metric,
    bounded_least_squares,
    metric,
    nominal,
)

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


ANGLES = 12
SPREAD = (0.1, 0.3, 0.5, 0.7, 1.0, 1.4)
"""Radii of a vector whose library has one level, in units of it."""
FREE = 0.5
"""Part of an effect found before by which it may give way."""
BETWEEN = 2
"""Points between two levels."""


class Sized(NamedTuple):
    """A signature at the size at which it comes nearest to the measurement."""

    signature: Signature
    u: np.ndarray
    cost: float
    z: np.ndarray
    """Tolerances that go with it."""


def grid(signature: Signature) -> list[np.ndarray]:
    """Return the coordinates at which a signature is compared."""
    levels, size = signature.levels, signature.variant.size
    if size == 2 and len(levels[1]) > 1 and np.isclose(levels[0].max(), levels[1].max()):
        radii = levels[0][levels[0] > 0.0]
        if len(radii) == 1:
            radii = radii[0] * np.array(SPREAD)
        else:
            radii = np.unique(np.concatenate([radii, np.sqrt(radii[1:] * radii[:-1])]))
        return [r * np.array([math.cos(a), math.sin(a)])
                for r in radii for a in 2.0 * math.pi * np.arange(ANGLES) / ANGLES]
    found = []
    for k, row in enumerate(levels):
        steps = np.linspace(0.0, 1.0, BETWEEN + 1, endpoint=False)
        dense = [a + s * (b - a) for a, b in zip(row, row[1:]) for s in steps]
        for x in (*dense, *row[-1:]):
            if x != 0.0:
                u = np.zeros(size)
                u[k] = x
                found.append(u)
    return found


class Sizing:
    """Measurement and library on the bent scale, about the nominal unit."""

    def __init__(
        self, evidence: Evidence, *, added: np.ndarray | None = None, about: Fit | None = None
    ) -> None:
        """Compare about the nominal unit.

        Parameters
        ----------
        evidence : the records.
        added : ndarray, shape (d,), or None. Features that another effect adds.
        about : a fit to compare about instead; its own effects are left free.
        """
        self.evidence = evidence
        self._ends = np.cumsum([len(b) for b in evidence.blocks])[:-1]
        if about is None:
            self.base, self._centre = nominal(evidence), np.zeros(evidence.tolerances.size)
            slope = np.vstack(evidence.slopes(self._centre))
        else:
            self.base, self._centre = list(about.mean), about.z
            own = about.slopes[:, :about.free] * np.repeat(
                [FREE * float(np.linalg.norm(t.u)) for t in about.terms],
                [t.variant.size for t in about.terms])
            slope = np.hstack([about.slopes[:, about.free:], own])
        if added is not None:
            self.base = [f + part for f, part in zip(self.base, np.split(added, self._ends))]
        self._rule = metric(evidence, self.base, runs=0, error=BENT_ERROR, bend=BEND, slope=slope)
        self._inner: Metric = metric(evidence, self.base, runs=0, error=BENT_ERROR, bend=BEND)
        self._columns = self._inner.columns(
            evidence, slope[:, :len(self._centre)], [b.values for b in evidence.blocks])
        self.target = self._rule.residual(evidence, self.base)

    def seen(self, added: np.ndarray) -> np.ndarray:
        """Return what effects add, shape (d, m), on the bent scale and whitened."""
        parts = np.split(added, self._ends)
        return np.vstack([
            white(self._rule.bent(k, f[:, None] + part))
            for k, (white, f, part) in enumerate(zip(self._rule.white, self.base, parts))])

    def tolerances(self, added: np.ndarray) -> np.ndarray:
        """Return the tolerances that go best with what effects add, shape (d,)."""
        mean = [f + part for f, part in zip(self.base, np.split(added, self._ends))]
        rest = self._inner.residual(self.evidence, mean)
        z, n = self._centre, len(self._centre)
        step = bounded_least_squares(self._columns, rest, -BAND - 1e-9 - z, BAND + 1e-9 - z,
                                     np.full(n, WEIGHT), z)
        return np.asarray(np.clip(z + step, -BAND, BAND))

    def best(self, signature: Signature, more: Sequence[np.ndarray] = ()) -> Sized:
        """Return a signature at its best size.

        Parameters
        ----------
        signature : of all records, stacked.
        more : further coordinates to compare.
        """
        points = [*grid(signature), *(u for u in more if np.any(u != 0.0))]
        added = np.array([signature.at(u) for u in points]).T
        cost = ((self.target[:, None] - self.seen(added))**2).sum(axis=0)
        k = int(np.argmin(cost))
        return Sized(signature, points[k], float(cost[k]), self.tolerances(added[:, k]))
