"""The shape of a law between the points of its grid."""

from __future__ import annotations

import numpy as np
from scipy import optimize

from ema_identification.rig.balance import Balance
from ema_identification.rig.laws import Term
from ema_identification.rig.laws.position import is_whole
from ema_identification.rig.sign_flips import orthonormal

EVALUATIONS = 14


def refined(balance: Balance, term: Term) -> Term:
    """Return the term with its shape moved between the neighbours on the grid.

    One parameter after the other. Whole numbers a turn stay whole; a parameter with one point
    on its grid is returned as it is.
    """
    for place in range(len(term.shape)):
        term = _moved(balance, term, place)
    return term


def _moved(balance: Balance, term: Term, place: int) -> Term:
    """Return the term with one parameter of its shape moved."""
    trajectory = balance.design.trajectory
    grid = sorted({shape[place] for shape in term.law.grid(trajectory)})
    if len(grid) < 2:
        return term
    value = term.shape[place]
    whole = term.law.periodic and not term.law.looked_for
    turns = trajectory.turns if trajectory.axis.motion == "rotary" else None
    if whole and turns is not None and is_whole(value, turns):
        return Term(law=term.law, shape=(float(round(value)),))
    basis = orthonormal(balance.free_columns)
    residual = balance.target - basis @ (basis.T @ balance.target)
    below = [g for g in grid if g < value]
    above = [g for g in grid if g > value]
    spacing = min(b - a for a, b in zip(grid[:-1], grid[1:]))
    low = below[-1] if below else value - min(spacing, 0.9 * abs(value))
    high = above[0] if above else value + spacing

    def at(candidate: float) -> Term:
        return Term(law=term.law, shape=(*term.shape[:place], candidate, *term.shape[place + 1:]))

    def left(candidate: float) -> float:
        columns = balance.design.columns(at(candidate), trajectory)
        columns = orthonormal(columns - basis @ (basis.T @ columns))
        return -float(np.sum((columns.T @ residual) ** 2))

    found = optimize.minimize_scalar(
        left, bounds=(low, high), method="bounded", options={"maxiter": EVALUATIONS})
    best = float(found.x) if found.fun < left(value) else value
    if whole and turns is not None and is_whole(best, turns):
        best = float(round(best))
    return at(best)
