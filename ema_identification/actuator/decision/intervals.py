"""Intervals of what was named: its coordinates and the unit's numbers, with a covariance.

A fit gives one point; how far off it may be, the simulator tells. Runs of the named model are
drawn over all that it may be (first the whole bands, then thrice the spread that those leave), in
directions at right angles, each to both sides. A plane through them gives mean and slopes, what
they leave of it the noise: that of repeats and of all that is not straight, measured where the law
is (statistical linearisation: Garcia-Fernandez et al., IEEE Trans. Signal Process. 63, 2015).
No slope is taken from where no law is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import count, islice
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.slopes import bounded_least_squares
from ema_identification.actuator.fleet.surrogate import BEND, shrunk
from ema_identification.actuator.laws.terms import LawFit, Posterior, bounds, coordinates, moved

RUNS, INTERVAL_ROUNDS, WIDER = 4, 2, 3.0
"""Budget: runs of a round, a coordinate; rounds; spread of the later ones, of what the one before
leaves: with so few runs, slopes over twice it drown in noise."""
LAW_SPREAD, FAR = 1.0 / WIDER, 10.0
"""Spread of the first round about a law, so that it is wide by the law's own size; in itself where
the library does not know the coordinate. Beyond so many of it the law is not expected."""
STRETCH = 1.13
"""Nine in ten of 316 values of panels 23 to 27 were within (split conformal: Lei et al. 2018)."""
SOLUTIONS = 4
"""Steps in which features that are off by more than `BEND` deviations lose weight."""


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


def simulated_posterior(unit: TestedUnit, fit: LawFit) -> Posterior:
    """Return what runs of a model tell of its laws and of the unit's numbers, see the module."""
    rounds = [r.known for r in islice(linearised(unit, fit), INTERVAL_ROUNDS)]
    if not rounds:  # beside what the simulator can do
        return posterior_of(unit, fit)
    return rounds[-1]._replace(covariance=STRETCH**2 * rounds[-1].covariance)


class Round(NamedTuple):
    """What runs over all that a model may be tell of it, and where they were, (n, width)."""

    known: Posterior
    points: np.ndarray
    features: np.ndarray


def linearised(unit: TestedUnit, fit: LawFit) -> Iterator[Round]:
    """Yield round after round, each over what the one before leaves, while they can be run."""
    sizes = [max(float(np.linalg.norm(t.u)), 1e-12) for t in fit.terms]
    spread = np.array([LAW_SPREAD * (size if len(levels) > 1 else 1.0)
                       for t, size in zip(fit.terms, sizes) for levels in t.signature.levels])
    low, high = (np.append(end, np.full(len(fit.z), side))
                 for end, side in zip(bounds(fit.terms), (-1.0, 1.0)))
    centre = np.append(coordinates(fit.terms), unit.centre)
    weight = np.append((FAR * spread) ** -2.0, unit.weight)
    found = Posterior(centre, np.diag(np.append(spread**2, 1.0 / unit.weight)))
    for k in count():
        rng = np.random.default_rng([unit.seed, 68, k])
        half = rng.standard_normal((RUNS * len(centre) // 4 * 2, len(centre)))
        half = np.linalg.qr(half).Q * np.sqrt(len(half))  # no slope pays for another one
        root = cholesky(found.covariance, lower=True) * (WIDER if k == 1 else 1.0)
        points = np.clip(found.mean + np.vstack([half, -half]) @ root.T, low, high)
        rows = np.array(unit.run_all(
            [(f.terms, f.z) for f in (at(fit, x) for x in points)], 1, salt=70 + k, apart=True))
        good = np.isfinite(rows).all(axis=1)
        if good.sum() < 2 * len(centre):
            return
        found = _solved(unit, (points[good], rows[good]), found.mean, (low, high),
                        (centre, weight))
        yield Round(found, points[good], rows[good])


def at(fit: LawFit, x: np.ndarray) -> LawFit:
    """Return a model at other coordinates and numbers."""
    return replace(fit, terms=moved(fit.terms, x[:fit.free]), z=x[fit.free:])


def _solved(
    unit: TestedUnit, runs: tuple[np.ndarray, np.ndarray], x: np.ndarray,
    ends: tuple[np.ndarray, np.ndarray], expected: tuple[np.ndarray, np.ndarray],
) -> Posterior:
    """Return where a plane through `runs` (points, features) meets the record, and how surely.

    The noise of the slopes is taken off the information (errors in variables with a variance that
    is known: Fuller, Measurement Error Models, 1987, section 2.2). The runs' own scatter gives the
    noise of the result, whatever correlation it was weighed by; to it comes what the record is off
    beyond a run.
    """
    (points, rows), (low, high), (centre, weight) = runs, ends, expected
    about = points.mean(axis=0)
    columns = np.hstack([np.ones((len(points), 1)), points - about])
    design = np.linalg.pinv(columns.T @ columns)  # of the middle, then of each slope
    plane = design @ (columns.T @ rows)
    slopes, rest, freedom = plane[1:].T, rows - columns @ plane, len(rows) - len(design)
    run = unit.noise()
    extra = unit.covariance(len(rest)) - run
    scale = np.sqrt(np.diag(run + extra))
    deviation = np.sqrt((rest**2).sum(axis=0) / freedom + np.diag(extra))
    bent, fresh = rest[::2] / deviation, rest[1::2]  # what weighs does not judge
    correlation, share = shrunk(bent)
    correlation += share * (run + extra) / np.outer(scale, scale)
    record = np.repeat(np.arange(len(unit.parts)), [p.size for p in unit.parts])
    correlation[record[:, None] != record] = 0.0  # of two records the noise is two
    scale = np.sqrt(np.diag(correlation))
    correlation /= np.outer(scale, scale)
    free = len(x) - len(unit.centre)
    for k in range(SOLUTIONS):
        off = unit.values - plane[0] - slopes @ (x - about)
        far = np.abs(off) / deviation / (BEND if k else 6.0 * BEND)  # first nearly all count
        grown = deviation * np.maximum(far, 1.0)
        factor = cho_factor(correlation * np.outer(grown, grown))
        weighed = cho_solve(factor, slopes)
        feigned = (rest.T * cho_solve(factor, rest.T)).sum() / freedom
        known = slopes.T @ weighed
        size = np.sqrt(np.append(np.diag(known)[:free], unit.weight))
        values, vectors = np.linalg.eigh(
            (known - feigned * design[1:, 1:]) / np.outer(size, size))
        values, vectors = values[values > 1e-9], vectors[:, values > 1e-9]
        root = (vectors * np.sqrt(values)).T * size
        target = vectors.T @ (weighed.T @ off / size) / np.sqrt(values)
        x = np.clip(x + bounded_least_squares(
            root, target, np.minimum(low - x, -1e-9), np.maximum(high - x, 1e-9), weight,
            x - centre), low, high)
    inverse = np.linalg.inv(root.T @ root + np.diag(weight))
    here = np.append(1.0, x - about)
    scatter = weighed.T @ fresh.T * np.sqrt(len(rest) / len(fresh))
    noise = weighed.T @ extra @ weighed + (
        scatter @ scatter.T * ((1.0 + here @ design @ here) / freedom))
    return Posterior(x, inverse @ (noise + np.diag(weight)) @ inverse)
