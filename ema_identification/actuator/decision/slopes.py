"""Slopes of a unit's features about a fit, by the simulator; steps by least squares."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import lsq_linear

from ema_identification.actuator.laws.terms import (
    EffectTerm,
    LawFit,
    NoiseScale,
    bounds,
    coordinates,
    library_slopes,
    moved,
)

RunAll = Callable[..., list[np.ndarray]]
STRONG, PART, UNKNOWN = 1.2, 0.2, 0.3
"""Effect (deviations, rms) from which its slope is simulated, and which a step need not exceed;
the step, of its size, and where the library does not know the coordinate."""
FINEST = PART / 4
"""Step, of its size, from which on noise would be more than what a law bends."""
HALF = 0.5
"""Step by which slopes to the unit's numbers are simulated (half widths)."""


def law_slopes(
    run_all: RunAll, fit: LawFit, mean: np.ndarray, scale: NoiseScale, runs: int
) -> np.ndarray:
    """Return the slopes to the coordinates of the laws, shape (d, coordinates).

    Simulated where a law is strong or the library does not know it; else the library's, which
    are less noisy.

    Parameters
    ----------
    run_all, runs : `TestedUnit.run_all`, and how many.
    fit, mean : where; the features there, ndarray, shape (d,).
    scale : what they may be off.
    """
    if not fit.terms:
        return np.zeros((len(mean), 0))
    found = library_slopes(fit.terms)
    u = coordinates(fit.terms)
    low, high = bounds(fit.terms)
    asked, k = [], 0
    for term in fit.terms:
        added = term.signature.at(term.u) / scale.deviation
        strong = float(np.sqrt(np.mean(added**2))) > STRONG
        size = float(np.linalg.norm(term.u))
        for levels in term.signature.levels:
            known = len(levels) > 1
            if strong or not known:
                there = u.copy()
                step = _step(term, scale) * size if known else UNKNOWN
                there[k] += step if u[k] + step <= high[k] else -step
                if low[k] <= there[k] and there[k] != u[k]:
                    asked.append((k, there))
            k += 1
    means = run_all([(moved(fit.terms, u1), fit.z) for _, u1 in asked], runs)
    for (k, there), f in zip(asked, means):
        if np.isfinite(f).all():
            found[:, k] = (f - mean) / (there[k] - u[k])
    return found


def _step(term: EffectTerm, scale: NoiseScale) -> float:
    """Return the step for the slope of a law, of its size: the least that shows clearly."""
    step, here = PART, term.signature.at(term.u)
    while step > FINEST:
        change = scale.bent(term.signature.at((1.0 + 0.5 * step) * term.u) - here)
        if np.sqrt(np.mean(change**2)) < STRONG:
            break
        step *= 0.5
    return step


def simulated_slopes(run_all: RunAll, fit: LawFit, runs: int) -> np.ndarray:
    """Return the slopes to the unit's numbers, simulated where the fit is, shape (d, width)."""
    steps = [fit.z + row for row in np.diag(np.where(fit.z > 0.0, -HALF, HALF))]
    here, *there = run_all([(fit.terms, z) for z in (fit.z, *steps)], runs, 61)
    slopes = fit.slopes[:, fit.free:].copy()
    for k, (mean, z) in enumerate(zip(there, steps)):
        if np.isfinite(mean).all() and np.isfinite(here).all():
            slopes[:, k] = (mean - here) / (z[k] - fit.z[k])
    return slopes


def bounded_least_squares(
    columns: np.ndarray, target: np.ndarray, low: np.ndarray, high: np.ndarray,
    weight: np.ndarray, centre: np.ndarray, damping: float = 0.0,
) -> np.ndarray:
    """Return the step within bounds that leaves least, shape (m,).

    Parameters
    ----------
    columns, target : ndarrays, shapes (d, m), (d,). Whitened slopes and residual.
    low, high : ndarrays, shape (m,). Bounds of the step; low < high.
    weight : ndarray, shape (m,). Of the squares of ``centre + step``, added to the sum.
    centre : ndarray, shape (m,). Where the step begins.
    damping : share of what the sum has of the square of each part of the step, added to it.
    """
    normal = columns.T @ columns + np.diag(weight)
    power = np.diag(normal) * (1.0 + damping)
    scale = np.maximum(np.sqrt(power), 1e-12)
    normal = normal / np.outer(scale, scale)
    np.fill_diagonal(normal, power / scale**2 + 1e-12)  # a law may do nothing
    root = np.linalg.cholesky(normal)
    pull = np.linalg.solve(root, (columns.T @ target - weight * centre) / scale)
    step = np.linalg.solve(root.T, pull)
    if (step < low * scale).any() or (step > high * scale).any():
        step = lsq_linear(root.T, pull, bounds=(low * scale, high * scale), method="bvls").x
    return np.clip(np.asarray(step) / scale, low, high)
