"""Intervals of what was named: its coordinates and the unit's numbers, with a covariance.

A fit gives one point; how far off it may be, runs of the named model tell: to both sides, first
over all that it may be, then over thrice what that leaves, or, where it tells nothing, over it
again. A plane through them gives mean and slopes, what they leave of it the noise of repeats and
of all that is not straight (Garcia-Fernandez et al., IEEE Trans. Signal Process. 63, 2015).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import count, islice
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky
from scipy.stats import chi2

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.slopes import bounded_least_squares
from ema_identification.actuator.fleet.surrogate import BEND, shrunk
from ema_identification.actuator.laws.terms import LawFit, Posterior, bounds, coordinates, moved

RUNS, INTERVAL_ROUNDS, WIDER = 4, 2, 3.0
"""Budget: runs of the first round, a coordinate, half of those of a later one; rounds; spread of
these, of what the one before leaves: with so few runs, slopes over twice it drown in noise."""
LAW_SPREAD, FAR = 1.0 / WIDER, 10.0
"""Spread of the first round about a law, so that it is wide by the law's own size; in itself where
the library does not know the coordinate. Beyond so many of it the law is not expected."""
SOLUTIONS, BEYOND = 4, 1.645
"""Steps in which what is far off loses weight; deviations from which information is no noise."""


def posterior_of(unit: TestedUnit, fit: LawFit) -> Posterior:
    """Return what a fit's own slopes tell: enough where no law is, as the library knows these."""
    white = unit.whitener(fit.runs, unit.without_law().mean if fit.terms else None)
    rest = unit.values - fit.mean
    columns = white.columns(fit.slopes, rest)
    weight = np.append(np.full(fit.free, 1e-9), unit.weight)
    pull = columns.T @ white.residual(rest)
    pull[fit.free:] -= unit.weight * (fit.z - unit.centre)
    covariance = np.linalg.inv(columns.T @ columns + np.diag(weight))
    return Posterior(np.append(coordinates(fit.terms), fit.z) + covariance @ pull, covariance)


def measured(unit: TestedUnit, fit: LawFit) -> tuple[Posterior, np.ndarray]:
    """Return what runs of a model tell of its laws and of the unit's numbers, and the slopes."""
    rounds = list(islice(linearised(unit, fit), INTERVAL_ROUNDS))
    if not rounds:  # beside what the simulator can do
        return posterior_of(unit, fit), fit.slopes
    return rounds[-1].known, rounds[-1].slopes


def p_sizes(known: Posterior, fit: LawFit) -> tuple[float, ...]:
    """Return how often each law would be measured as far from none if it had no size (Wald 1943).

    Sizes are the coordinates with levels: the other ones say how a law goes on.
    """
    found, begin = [], 0
    for term in fit.terms:
        own = begin + np.flatnonzero([len(levels) > 0 for levels in term.variant.levels])
        size = known.mean[own]
        found.append(float(chi2.sf(
            size @ np.linalg.solve(known.covariance[np.ix_(own, own)], size), len(own))))
        begin += term.variant.size
    return tuple(found)


class Round(NamedTuple):
    """What runs over all that a model may be tell of it, and where they were, (n, width)."""

    known: Posterior
    points: np.ndarray
    features: np.ndarray
    slopes: np.ndarray
    """Of the planes through them, shape (d, width)."""


def linearised(unit: TestedUnit, fit: LawFit) -> Iterator[Round]:
    """Yield round after round, each over what the one before leaves, while they can be run."""
    sizes = [max(float(np.linalg.norm(t.u)), 1e-12) for t in fit.terms]
    spread = np.array([LAW_SPREAD * (size if len(levels) > 1 else 1.0)
                       for t, size in zip(fit.terms, sizes) for levels in t.signature.levels])
    low, high = (np.append(end, np.full(len(fit.z), side) * unit.edge)
                 for end, side in zip(bounds(fit.terms), (-1.0, 1.0)))
    centre = np.append(coordinates(fit.terms), unit.centre)
    weights = [np.append((far * spread) ** -2.0, unit.weight) for far in (1.0, FAR)]  # by round
    found = Posterior(centre, np.diag(np.append(spread**2, 1.0 / unit.weight)))
    for k in count():
        rng = np.random.default_rng([unit.seed, 68, k])
        half = rng.standard_normal((RUNS * (1 + min(k, 1)) * len(centre) // 4 * 2, len(centre)))
        half = np.linalg.qr(half).Q * np.sqrt(len(half))  # no slope pays for another one
        root = cholesky(found.covariance, lower=True) * (WIDER if k == 1 else 1.0)
        points = np.clip(found.mean + np.vstack([half, -half]) @ root.T, low, high)
        rows = np.array(unit.run_all(
            [(f.terms, f.z) for f in (at(fit, x) for x in points)], 1, salt=70 + k, apart=True))
        good = np.isfinite(rows).all(axis=1)
        if good.sum() < 2 * len(centre):
            return
        found, slopes = _solved(unit, (points[good], rows[good]), found.mean, (low, high),
                                (centre, weights[min(k, 1)]))
        yield Round(found, points[good], rows[good], slopes)


def at(fit: LawFit, x: np.ndarray) -> LawFit:
    """Return a model at other coordinates and numbers."""
    return replace(fit, terms=moved(fit.terms, x[:fit.free]), z=x[fit.free:])


class _Plane(NamedTuple):
    """A plane through the runs of one record, and what its features weigh.

    Slopes are nothing to numbers that the record does not know: those of another one's day.
    """

    values: np.ndarray
    middle: np.ndarray
    slopes: np.ndarray
    rest: np.ndarray
    """Of the runs, shape (n, d)."""
    design: np.ndarray
    """Covariance of middle and slopes, of features of variance 1: (1 + width, 1 + width)."""
    freedom: int
    extra: np.ndarray
    """Covariance of what the record is off beyond a run."""
    deviation: np.ndarray
    correlation: np.ndarray

    @classmethod
    def through(
        cls, part: TestedUnit, knows: np.ndarray, offsets: np.ndarray, rows: np.ndarray
    ) -> _Plane:
        """Return it, of features (n, d) at offsets (n, width), of which the record knows some."""
        shown = np.append(0, 1 + knows)
        columns = np.hstack([np.ones((len(offsets), 1)), offsets[:, knows]])
        design = np.zeros((1 + offsets.shape[1],) * 2)
        design[np.ix_(shown, shown)] = inverse = np.linalg.pinv(columns.T @ columns)
        plane = np.zeros((len(design), rows.shape[1]))
        plane[shown] = inverse @ (columns.T @ rows)
        rest, freedom = rows - columns @ plane[shown], len(rows) - len(shown)
        run = part.noise()
        extra = part.covariance(len(rest)) - run
        scale = np.sqrt(np.diag(run + extra))
        deviation = np.sqrt((rest**2).sum(axis=0) / freedom + np.diag(extra))
        correlation, share = shrunk(rest[::2] / deviation)  # what weighs does not judge
        correlation += share * (run + extra) / np.outer(scale, scale)
        scale = np.sqrt(np.diag(correlation))
        return cls(part.values, plane[0], plane[1:].T, rest, design, freedom, extra, deviation,
                   correlation / np.outer(scale, scale))

    def weighed(self, offset: np.ndarray, bend: float
                ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the rest, slopes weighed, scale and error of the noise by runs that weigh not."""
        left = self.values - self.middle - self.slopes @ offset
        grown = self.deviation * np.maximum(np.abs(left) / self.deviation / bend, 1.0)
        factor = cho_factor(self.correlation * np.outer(grown, grown))
        judges = self.rest[1::2] * np.sqrt(len(self.rest) / len(self.rest[1::2]) / self.freedom)
        noise = judges @ cho_solve(factor, judges.T)
        scale = np.array([np.trace(noise), np.sqrt(2.0 * (noise**2).sum())])
        return left, cho_solve(factor, self.slopes), scale


def _solved(
    unit: TestedUnit, runs: tuple[np.ndarray, np.ndarray], x: np.ndarray,
    ends: tuple[np.ndarray, np.ndarray], expected: tuple[np.ndarray, np.ndarray],
) -> tuple[Posterior, np.ndarray]:
    """Return where planes through `runs` (points, features) meet the records, how surely, slopes.

    The noise of the slopes, new to the weights, is taken off information and pull (errors in
    variables with a variance that is known: Fuller, Measurement Error Models, 1987, section 2.2);
    what is left within what that noise varies by (`BEYOND`) is none. The runs' own scatter,
    whatever it was weighed by, and what the record is off beyond a run are the result's noise.
    """
    (points, rows), (low, high), (centre, weight) = runs, ends, expected
    about, free = points.mean(axis=0), len(x) - len(unit.centre)
    planes = [_Plane.through(part, np.append(np.arange(free), free + places), points - about, own)
              for part, places, own in zip(unit.parts, unit.places, unit.split(rows))]
    for k in range(SOLUTIONS):
        bend = BEND if k else 6.0 * BEND  # first nearly all count
        found = [(p, *p.weighed(x - about, bend)) for p in planes]
        known = sum(p.slopes.T @ weighed for p, _, weighed, _ in found)
        noise, doubt = np.sum([s[:, None, None] * p.design[1:, 1:] for p, _, _, s in found], 0)
        pull = sum(weighed.T @ left for _, left, weighed, _ in found) + noise @ (x - about)
        size = np.sqrt(np.append(np.diag(known)[:free], unit.weight))
        values, vectors = np.linalg.eigh((known - noise) / np.outer(size, size))
        sure = values > np.maximum(1e-9, BEYOND * np.einsum(
            "ik,ij,jk->k", vectors, doubt / np.outer(size, size), vectors))
        values, vectors = values[sure], vectors[:, sure]
        root = (vectors * np.sqrt(values)).T * size
        target = vectors.T @ (pull / size) / np.sqrt(values)
        x = np.clip(x + bounded_least_squares(
            root, target, np.minimum(low - x, -1e-9), np.maximum(high - x, 1e-9), weight,
            x - centre), low, high)
    inverse = np.linalg.inv(root.T @ root + np.diag(weight))
    here = np.append(1.0, x - about)
    kept = size[:, None] * (vectors @ vectors.T) / size  # of the pull: what is not sure has none
    extra = kept @ sum(w.T @ p.extra @ w for p, _, w, _ in found) @ kept.T
    scatter = kept @ np.sum([w.T @ p.rest[1::2].T * np.sqrt(
        (1.0 + here @ p.design @ here) / p.freedom * len(p.rest) / len(p.rest[1::2]))
        for p, _, w, _ in found], axis=0)
    known = Posterior(x, inverse @ (np.diag(weight) + extra + scatter @ scatter.T) @ inverse)
    return known, np.vstack([p.slopes for p in planes])
