"""Least squares with the simulator: damped Gauss-Newton steps, each kept only if it helps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ema_identification.actuator.measure.tolerances import PRIOR
from ema_identification.actuator.surrogate.evidence import Evidence, solve
from ema_identification.actuator.surrogate.fit import (
    Fit,
    Point,
    bounds,
    coordinates,
    deviation_of,
    moved,
    run_point,
    simulated_slopes,
    simulated_tolerances,
    slopes_with_aliases,
)
from ema_identification.actuator.surrogate.likelihood import (
    BAND,
    WEIGHT,
    Robust,
    bounded_least_squares,
)

TRIALS = 2
"""Dampings tried before a point counts as the lowest."""
LONGEST = 1.0
"""Step of a coordinate, of its size, and of a tolerance (half widths)."""
SMALL = 1.0
"""Fall of the cost, in units of the cost a feature, that is worth a step."""
CLEAR = 4.0
"""Mean square of what a step did unforeseen, in units of a repeat, from which it is learnt."""


def descend(
    evidence: Evidence, metric: Robust, point: Point, *, steps: int, seed: int,
    worth: float = SMALL, thorough: bool = False,
) -> Point:
    """Return a point of lower cost, at most `steps` steps away.

    Parameters
    ----------
    evidence : the records.
    metric : of the cost.
    point : to start from; must be finite.
    steps : most steps.
    seed : of the runs, the same for all points that are compared.
    worth : fall of the cost that is worth a step, in units of the cost a feature.
    thorough : whether the slopes to the tolerances are simulated too.
    """
    if point.runs != metric.runs:
        again = run_point(evidence, point.terms, point.z, runs=metric.runs, seed=seed)
        if not again.finite:
            return point
        point = replace(again, slopes=point.slopes, damping=point.damping)
    cost = metric.cost(evidence, point.mean, point.z)
    fresh = True
    for _ in range(steps):
        if fresh or point.slopes is None:
            point = _with_slopes(evidence, point, metric.runs, seed, thorough)
            thorough = False
        following, lower = _step(evidence, metric, point, cost, seed, worth)
        if following is point:
            break
        size = np.linalg.norm(coordinates(point.terms))
        change = np.linalg.norm(coordinates(following.terms) - coordinates(point.terms))
        fresh = bool(change > 0.1 * size)
        done = cost - lower < worth * lower / evidence.size
        point, cost = following, lower
        if done:
            break
    return point


def _with_slopes(
    evidence: Evidence, point: Point, runs: int, seed: int, thorough: bool = False
) -> Point:
    slope_u = simulated_slopes(evidence, point.terms, point.z, point.mean, runs=runs, seed=seed)
    if point.slopes is not None and not thorough:  # those to the tolerances as learnt
        return replace(point, slopes=np.hstack([slope_u, point.slopes[:, slope_u.shape[1]:]]))
    slope_z = slopes_with_aliases(evidence, point.terms, point.z, slope_u)
    if thorough:
        slope_z = simulated_tolerances(evidence, point.terms, point.z, point.mean, slope_z,
                                       runs=runs, seed=seed)
        slope_z = slopes_with_aliases(evidence, point.terms, point.z, slope_u, slope_z)
    return replace(point, slopes=np.hstack([slope_u, slope_z]))


def _step(
    evidence: Evidence, metric: Robust, point: Point, cost: float, seed: int, worth: float
) -> tuple[Point, float]:
    """Return the next point and its cost; `point` itself if no step lowers it."""
    local = metric.at(evidence, point.mean)
    rest = local.residual(evidence, point.mean)
    damping, slopes = point.damping, point.slopes
    assert slopes is not None
    for _ in range(TRIALS):
        step, promised = bounded_step(
            local.columns(evidence, slopes, point.mean), rest, point, damping)
        if promised < 0.2 * worth * cost / evidence.size:
            break
        free = len(coordinates(point.terms))
        terms = moved(point.terms, coordinates(point.terms) + step[:free])
        trial = run_point(evidence, terms, point.z + step[free:], runs=metric.runs, seed=seed)
        if trial.finite:
            slopes = _learnt(evidence, point, trial, slopes, metric.runs)
            lower = metric.cost(evidence, trial.mean, trial.z)
            if lower < cost:
                good = cost - lower > 0.5 * promised
                return replace(trial, slopes=slopes,
                               damping=damping * (0.1 if good else 1.0)), lower
        damping = max(10.0 * damping, 0.03)
    return point, cost


def bounded_step(
    columns: np.ndarray, rest: np.ndarray, point: Point, damping: float
) -> tuple[np.ndarray, float]:
    """Return the damped step within the bounds, and the fall of the cost that it promises.

    Parameters
    ----------
    columns : ndarray, shape (d, m). Whitened slopes.
    rest : ndarray, shape (d,). Whitened residual.
    point : where the step begins.
    damping : of Levenberg and Marquardt.
    """
    u = coordinates(point.terms)
    free, m = len(u), columns.shape[1]
    weight = np.zeros(m)
    weight[free:] = WEIGHT
    centre = np.concatenate([u, point.z])
    low, high = _room(point, u)
    curve = np.sqrt(damping * ((columns**2).sum(axis=0) + weight))
    step = bounded_least_squares(
        np.vstack([columns, np.diag(curve)]), np.concatenate([rest, np.zeros(m)]), low, high,
        weight, centre)
    left = rest - columns @ step
    promised = rest @ rest - left @ left + weight @ (centre**2 - (centre + step)**2)
    return step, float(promised)


def _room(point: Point, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and largest step of each unknown."""
    lower, upper = bounds(point.terms)
    length = []
    for term in point.terms:
        for levels in term.signature.levels:
            least = float(np.abs(levels[levels != 0.0]).min()) if len(levels) > 1 else 1.0
            length.append(max(LONGEST * float(np.linalg.norm(term.u)), 2.0 * least))
    far = np.array(length)
    low = np.concatenate([np.maximum(lower - u, -far),
                          np.maximum(-BAND - point.z, -LONGEST)])
    high = np.concatenate([np.minimum(upper - u, far),
                           np.minimum(BAND - point.z, LONGEST)])
    return np.minimum(low, -1e-12), np.maximum(high, 1e-12)


def _learnt(
    evidence: Evidence, point: Point, trial: Point, slopes: np.ndarray, runs: int
) -> np.ndarray:
    """Return the slopes corrected by what a step really did (Broyden)."""
    du = coordinates(trial.terms) - coordinates(point.terms)
    step = np.concatenate([du, trial.z - point.z])
    scale = np.concatenate([
        np.repeat([max(float(np.linalg.norm(t.u)), 1e-12) for t in point.terms],
                  [t.variant.size for t in point.terms]), np.full(len(point.z), PRIOR)])
    weight = step / scale**2
    power = float(step @ weight)
    missed = np.concatenate(trial.mean) - np.concatenate(point.mean) - slopes @ step
    clear = float(((missed / deviation_of(evidence))**2).mean()) * runs / 2.0 > CLEAR
    return slopes + np.outer(missed, weight) / power if clear and power > 0.0 else slopes


def finished(
    evidence: Evidence, metric: Robust, point: Point, *, seed: int, runs: int,
) -> Fit:
    """Return the fit at a point, after a last linear step.

    Parameters
    ----------
    evidence : the records.
    metric : of the cost.
    point : where the descent ended.
    seed : of the runs.
    runs : of the last, fresh prediction.
    """
    again = run_point(evidence, point.terms, point.z, runs=runs, seed=seed)
    if again.finite:
        point = replace(again, slopes=point.slopes)
    if point.slopes is None:
        point = _with_slopes(evidence, point, point.runs, seed)
    slopes = point.slopes
    assert slopes is not None
    u = coordinates(point.terms)
    free = len(u)
    slopes = np.hstack([slopes[:, :free], slopes_with_aliases(
        evidence, point.terms, point.z, slopes[:, :free], slopes[:, free:])])
    local = metric.at(evidence, point.mean)
    columns = local.columns(evidence, slopes, point.mean)
    rest = local.residual(evidence, point.mean)
    _, covariance = solve(columns, rest, point.z, free, local.feigned)
    step, _ = bounded_step(columns, rest, point, 0.0)
    terms = moved(point.terms, u + step[:free])
    step[:free] = coordinates(terms) - u
    mean, at = [], 0
    for f in point.mean:
        mean.append(f + slopes[at:at + len(f)] @ step)
        at += len(f)
    z = point.z + step[free:]
    return Fit(terms=terms, z=z, covariance=covariance, cost=metric.cost(evidence, mean, z),
               mean=tuple(mean), runs=point.runs, slopes=slopes)
