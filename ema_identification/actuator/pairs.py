"""Two effects at once: which pairs of signatures explain what no single one does."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.evidence import MODEL_ERROR, Evidence
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.refit import Fit, Term, refit
from ema_identification.actuator.screening import (
    Residual,
    Screened,
    residual,
    screen,
    selectable,
    stacked,
)

ANGLES = 8
RADII = (0.02, 0.25, 1.0)
"""Of the largest level of a vector, where pairs are tried."""
SCALE = (0.3, 3.0)
"""Factors on a point of the grid within which its signature counts as straight."""
GREEDY = 2
"""Single fits that are continued, and seconds that are tried for each."""
GRID = 3
"""Pairs taken from the grid."""


def _points(size: int, levels: Sequence[np.ndarray]) -> list[np.ndarray]:
    if size == 1:
        return [np.array([x]) for x in levels[0] if x != 0.0]
    if size == 2 and len(levels[1]) > 1 and np.isclose(levels[0].max(), levels[1].max()):
        top = float(levels[0].max())
        return [top * r * np.array([math.cos(a), math.sin(a)])
                for r in RADII for a in 2.0 * math.pi * np.arange(ANGLES) / ANGLES]
    found = []
    for k, row in enumerate(levels):
        for x in row:
            if x != 0.0:
                u = np.zeros(size)
                u[k] = x
                found.append(u)
    return found


def screen_pairs(
    evidence: Evidence, rest: Residual, *, without: Sequence[str] = (), keep: int = GRID
) -> list[tuple[Screened, Screened]]:
    """Return the best pairs of different effects, each at its best point of a grid.

    Parameters
    ----------
    evidence : the records.
    rest : residual that the pair is to explain.
    without : effects that are not considered.
    keep : how many pairs.
    """
    indices, points, rows = [], [], []
    for index in selectable(evidence, without):
        signature = stacked(evidence, index)
        for u in _points(signature.variant.size, signature.levels):
            indices.append(index)
            points.append(u)
            rows.append(signature.at(u))
    if not rows:
        return []
    white = rest.white(np.array(rows).T)
    gram, pull = white.T @ white, white.T @ rest.target
    power = np.diag(gram)
    determinant = np.outer(power, power) - gram**2
    usable = determinant > 1e-3 * np.outer(power, power)
    safe = np.where(usable, determinant, 1.0)
    a = np.clip((power[None, :] * pull[:, None] - gram * pull[None, :]) / safe, *SCALE)
    b = np.clip((power[:, None] * pull[None, :] - gram * pull[:, None]) / safe, *SCALE)
    cost = (rest.cost - 2.0 * (a * pull[:, None] + b * pull[None, :]) + a**2 * power[:, None]
            + b**2 * power[None, :] + 2.0 * a * b * gram)
    variants = [evidence.blocks[0].library.signatures[i].variant for i in indices]
    effects = np.array([v.effect for v in variants])
    cost[(effects[:, None] == effects[None, :]) | ~usable] = np.inf
    found: list[tuple[Screened, Screened]] = []
    seen: set[frozenset[str]] = set()
    for flat in np.argsort(cost, axis=None)[:4000]:
        i, j = divmod(int(flat), len(rows))
        key = frozenset((variants[i].effect, variants[j].effect))
        if not np.isfinite(cost[i, j]) or key in seen:
            continue
        seen.add(key)
        z = rest.tolerances(a[i, j] * rows[i] + b[i, j] * rows[j])
        found.append((
            Screened(variant=variants[i], index=indices[i], u=a[i, j] * points[i],
                     cost=float(cost[i, j]), z=z),
            Screened(variant=variants[j], index=indices[j], u=b[i, j] * points[j],
                     cost=float(cost[i, j]), z=z),
        ))
        if len(found) == keep:
            break
    return found


def seconds(
    evidence: Evidence, fit: Fit, null: Recalibration, *, without: Sequence[str] = (),
    keep: int = GREEDY,
) -> tuple[Residual, list[Screened]]:
    """Return what a fit leaves, and the effects that would explain most of that."""
    names = {t.variant.effect for t in fit.terms}
    free = [fit.slopes[:, k] * math.sqrt(max(fit.covariance[k, k], 0.0)) * 100.0
            for k in range(fit.free)]
    rest = residual(evidence, fit.z, fit.mean, runs=fit.runs, free=free, scatter=[
        MODEL_ERROR * (f - f0) for f, f0 in zip(fit.mean, null.mean)])
    chosen: list[Screened] = []
    for found in screen(evidence, rest, without=[*without, *names]):
        if all(found.variant.effect != c.variant.effect for c in chosen):
            chosen.append(found)
        if len(chosen) == keep:
            break
    return rest, chosen


def fit_pairs(
    evidence: Evidence, singles: Sequence[Fit], far: Residual, null: Recalibration, *,
    without: Sequence[str] = (), seed: int = 0,
) -> list[Fit]:
    """Return joint fits of two effects, best first."""
    plans: list[tuple[list[Term], np.ndarray]] = []
    seen: set[frozenset[str]] = set()
    for fit in singles[:GREEDY]:
        if not np.isfinite(fit.cost):
            continue
        for second in seconds(evidence, fit, null, without=without)[1]:
            key = frozenset((fit.terms[0].variant.name, second.variant.name))
            if key not in seen:
                seen.add(key)
                plans.append(([fit.terms[0], _term(evidence, second)], fit.z))
    for first, second in screen_pairs(evidence, far, without=without):
        key = frozenset((first.variant.name, second.variant.name))
        if key not in seen:
            seen.add(key)
            plans.append(([_term(evidence, first), _term(evidence, second)], first.z))
    found: list[Fit] = []
    best = np.inf
    for terms, z in plans:
        found.append(refit(evidence, terms, z, null.mean, seed=seed, give_up=3.0 * best))
        best = min(best, found[-1].cost)
    return sorted(found, key=lambda f: f.cost)


def swapped(
    evidence: Evidence, pairs: Sequence[Fit], null: Recalibration, *,
    without: Sequence[str] = (), seed: int = 0,
) -> list[Fit]:
    """Return `pairs` and the best one with either effect replaced by what comes nearest to it."""
    best = pairs[0]
    base = evidence.blocks[0].library.model.effects
    names = {t.variant.effect for t in best.terms}
    known = {frozenset(t.variant.name for t in f.terms) for f in pairs}
    found = list(pairs)
    for kept in best.terms:
        alone = evidence.mean(best.z, kept.variant.effects(kept.u, base), runs=best.runs,
                              seed=seed + 30)
        rest = residual(evidence, best.z, alone, runs=best.runs, scatter=[
            MODEL_ERROR * (f - f0) for f, f0 in zip(best.mean, null.mean)])
        tried: set[str] = set()
        for other in screen(evidence, rest, without=[*without, *names]):
            if len(tried) == GREEDY:
                break
            key = frozenset((kept.variant.name, other.variant.name))
            if other.variant.effect in tried or key in known:
                continue
            tried.add(other.variant.effect)
            found.append(refit(evidence, [kept, _term(evidence, other)], best.z, null.mean,
                               seed=seed, give_up=2.0 * best.cost))
    return sorted((f for f in found if np.isfinite(f.cost)), key=lambda f: f.cost)


def _term(evidence: Evidence, screened: Screened) -> Term:
    return Term(variant=screened.variant, signature=stacked(evidence, screened.index),
                u=screened.u)
