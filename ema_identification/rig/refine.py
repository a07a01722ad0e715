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

    Whole numbers a turn stay whole; a law with one point on its grid is returned as it is.
    """
    trajectory = balance.design.trajectory
    grid = sorted(shape[0] for shape in term.law.grid(trajectory)) if term.law.shape else []
    if len(grid) < 2:
        return term
    value = term.shape[0]
    if term.law.periodic and trajectory.axis.motion == "rotary" \
            and is_whole(value, trajectory.turns):
        return Term(law=term.law, shape=(float(round(value)),))
    basis = orthonormal(balance.free_columns)
    residual = balance.target - basis @ (basis.T @ balance.target)
    below = [g for g in grid if g < value]
    above = [g for g in grid if g > value]
    spacing = min(b - a for a, b in zip(grid[:-1], grid[1:]))
    low = below[-1] if below else value - 0.9 * spacing
    high = above[0] if above else value + spacing

    def left(candidate: float) -> float:
        columns = balance.design.columns(Term(law=term.law, shape=(candidate,)), trajectory)
        columns = orthonormal(columns - basis @ (basis.T @ columns))
        return -float(np.sum((columns.T @ residual) ** 2))

    found = optimize.minimize_scalar(
        left, bounds=(low, high), method="bounded", options={"maxiter": EVALUATIONS})
    best = float(found.x) if found.fun < left(value) else value
    if term.law.periodic and trajectory.axis.motion == "rotary" \
            and is_whole(best, trajectory.turns):
        best = float(round(best))
    return Term(law=term.law, shape=(best,))
