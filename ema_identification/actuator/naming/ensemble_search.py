"""Go on where Gauss-Newton steps stop: regression on many runs at once, and compass search.

Limit cycles make the cost a narrow cusp, on which slopes from one small move a coordinate point
anywhere. A regression on runs that move all unknowns at once, and by much, averages that out: it
leads near the lowest point from far away (the linear step of an ensemble Kalman inversion;
Iglesias, Law and Stuart 2013). Trying each coordinate of the effects in turn then finds the point
itself (compass search; Kolda, Lewis and Torczon 2003).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.surrogate.evidence import Evidence
from ema_identification.actuator.surrogate.fit import (
    EffectTerm,
    Point,
    bounds,
    coordinates,
    deviation_of,
    moved,
    run_points,
    runs_around,
)
from ema_identification.actuator.surrogate.likelihood import (
    BAND,
    WEIGHT,
    Robust,
    bounded_least_squares,
)

MEMBERS = 64
"""Runs of a regression, half of them mirrored to the other half."""
RIDGE = 1.0
"""Of its slopes, in units of a run."""
REACH = 1.5
"""Longest step, in units of the spread of the runs."""
SWEEPS = 4
"""Solutions, each with the bounded metric about the one before."""
TRIED = (0.5, 0.2, 0.1)
"""Moves of a coordinate in the compass search, of the size of its effect."""
MOVES = 4
"""Most moves of one length."""


class Spread(NamedTuple):
    """Half widths of the runs of a regression about their centre."""

    effect: float
    """Of a coordinate of an effect, of its size."""
    tolerance: float
    """In half widths of the tolerance."""


SPREADS = (Spread(0.3, 0.5), Spread(0.2, 0.3))
"""Of regressions one after another."""
REGRESSIONS = 6
"""Most of them: one that ends at the edge of its runs is repeated there."""
EDGE = 1.0
"""Step of an effect, in units of the spread of the runs, that counts as the edge."""


def sizes_of(terms: Sequence[EffectTerm]) -> np.ndarray:
    """Return the scale of each coordinate: the size of its effect, 1 where that is unknown."""
    return np.array([
        max(float(np.linalg.norm(t.u)), 1e-12) if len(levels) > 1 else 1.0
        for t in terms for levels in t.signature.levels])


def approached(
    evidence: Evidence, rule: Robust, terms: tuple[EffectTerm, ...], z: np.ndarray, *, seed: int
) -> tuple[tuple[EffectTerm, ...], np.ndarray]:
    """Return effects and tolerances after regressions one after another (see `regressed`)."""
    k = 0
    for trial in range(REGRESSIONS):
        before, wide = coordinates(terms), SPREADS[k].effect * sizes_of(terms)
        terms, z = regressed(evidence, rule, terms, z, spread=SPREADS[k], seed=seed + trial)
        if np.all(np.abs(coordinates(terms) - before) < EDGE * wide):
            k += 1
            if k == len(SPREADS):
                break
    return terms, z


def regressed(
    evidence: Evidence, rule: Robust, terms: tuple[EffectTerm, ...], z: np.ndarray, *,
    spread: Spread, seed: int,
) -> tuple[tuple[EffectTerm, ...], np.ndarray]:
    """Return effects and tolerances after one step with slopes from runs all around.

    Parameters
    ----------
    evidence : the records.
    rule : metric; what the runs scatter about the regression is added to its errors.
    terms, z : centre of the runs.
    spread : of the runs.
    seed : of the moves and of the noise.
    """
    start, wide = coordinates(terms), np.concatenate([
        spread.effect * sizes_of(terms), np.full(len(z), spread.tolerance)])
    moves, runs = _ensemble(evidence, terms, z, wide, seed)
    columns = np.hstack([np.ones((len(moves), 1)), moves / wide])
    if len(moves) <= columns.shape[1]:
        return terms, z
    penalty = RIDGE * np.eye(columns.shape[1])
    penalty[0, 0] = 0.0
    weights = np.linalg.solve(columns.T @ columns + penalty, columns.T @ runs)
    freedom = len(moves) - columns.shape[1]
    variance = ((runs - columns @ weights)**2).sum(axis=0) / freedom
    scatter = np.sqrt(np.maximum(0.0, variance - deviation_of(evidence)**2))
    ends = np.cumsum([len(b) for b in evidence.blocks])[:-1]
    rule = replace(rule, scatter=tuple(np.split(scatter, ends)), runs=len(moves))
    centre, slopes = weights[0], (weights[1:] / wide[:, None]).T
    low, high = bounds(terms)
    least = np.maximum(np.concatenate([low - start, -BAND - z]), -REACH * wide)
    most = np.minimum(np.concatenate([high - start, BAND - z]), REACH * wide)
    weight = np.concatenate([np.zeros(len(start)), np.full(len(z), WEIGHT)])
    step = np.zeros(len(wide))
    about = np.split(centre, ends)
    for _ in range(SWEEPS):
        local = rule.at(evidence, np.split(centre + slopes @ step, ends))
        step = bounded_least_squares(
            local.columns(evidence, slopes, about), local.residual(evidence, about),
            np.minimum(least, -1e-12), np.maximum(most, 1e-12), weight,
            np.concatenate([start, z]))
    return (moved(terms, start + step[:len(start)]),
            np.clip(z + step[len(start):], -BAND, BAND))


def _ensemble(
    evidence: Evidence, terms: tuple[EffectTerm, ...], z: np.ndarray, wide: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the moves from the centre, shape (n, unknowns), and the features, shape (n, d)."""
    rng = np.random.default_rng([seed, 11])
    half = rng.uniform(-1.0, 1.0, size=(MEMBERS // 2, len(wide)))
    moves = np.vstack([half, -half]) * wide
    seeds = [int(rng.integers(2**31)) for _ in moves]
    return runs_around(evidence, terms, z, moves, seeds, band=BAND)


def compass(evidence: Evidence, metric: Robust, point: Point, *, seed: int) -> Point:
    """Return the lowest point found by moving one coordinate of the effects after another.

    Parameters
    ----------
    evidence : the records.
    metric : of the cost.
    point : where to start; its features must be of `metric.runs` runs.
    seed : of the runs, the same for all points.
    """
    cost = metric.cost(evidence, point.mean, point.z)
    for share in TRIED:
        for _ in range(MOVES):
            best: tuple[float, Point] | None = None
            moves = [sign * share * d for d in _directions(point.terms) for sign in (1.0, -1.0)]
            trials = run_points(
                evidence, [(moved(point.terms, coordinates(point.terms) + m), point.z)
                           for m in moves], runs=metric.runs, seed=seed)
            for trial in trials:
                if not trial.finite:
                    continue
                lower = metric.cost(evidence, trial.mean, trial.z)
                if lower < (best[0] if best else cost - cost / evidence.size):
                    best = lower, trial
            if best is None:
                break
            cost, point = best
    return point


def _directions(terms: Sequence[EffectTerm]) -> list[np.ndarray]:
    """Return moves of the coordinates: a vector's length and its angle, else one by one."""
    found, at, sizes = [], 0, sizes_of(terms)
    for term in terms:
        n = term.variant.size
        rows = np.diag(sizes[at:at + n])
        if n == 2 and term.variant.levels[0] == term.variant.levels[1]:
            rows = np.array([term.u, [-term.u[1], term.u[0]]])
        for row in rows:
            whole = np.zeros(len(sizes))
            whole[at:at + n] = row
            found.append(whole)
        at += n
    return found
