"""Whether a wave in position is one of the axis, or of the motion that was recorded.

A motion of commensurate frequencies reverses and hurries at always the same places: what dry
friction leaves at reversals, and what follows the speed, then repeats in position too.
"""

from __future__ import annotations

import numpy as np

from ema_identification.rig.fit.balance import InputBalance
from ema_identification.rig.fit.sign_flips import orthonormal, squares_taken
from ema_identification.rig.laws.base import Term
from ema_identification.rig.laws.static import LEAST_PERIODS, wave

PHASES, SPEEDS = 8, 5
"""Bins of the phase of a wave, and of the speed: equal numbers of rows each."""
SEVERAL = 3
"""Bins of the speed in which a phase is seen at least ..."""
MOST_PHASES = 0.75
"""... for this share of the phases."""
STAYS = 0.6
"""Least part of a wave, along its own phase, that is left without the rows near reversals."""
CLOSE = 8.0
"""Periods in the travel up to which a slower wave may be what is there."""
LEAST_ROWS = 10
"""Rows a coefficient that are needed to look without the others."""


def wave_stands(balance: InputBalance, index: int) -> bool:
    """Return whether the wave at `index` is seen at several speeds, and away from reversals.

    Parameters
    ----------
    balance : fitted, with the wave.
    index : its term.
    """
    trajectory = balance.design.trajectory
    order = balance.terms[index].shape[0]
    phase = np.mod(wave(trajectory, order) * trajectory.position, 2.0 * np.pi)
    if not _at_several_speeds(phase, trajectory.speed) or _slower_does_better(balance, index):
        return False
    away = trajectory.steady
    columns = balance.columns
    if away.all() or away.sum() < LEAST_ROWS * columns.shape[1]:
        return True
    scale = np.sqrt(np.maximum(np.mean(columns[away] ** 2, axis=0), 1e-300))
    alone, *_ = np.linalg.lstsq(columns[away] / scale, trajectory.target[away], rcond=1e-8)
    span = balance.span(index)
    whole, rest = balance.fit.coefficients[span], (alone / scale)[span]
    return bool(whole @ rest >= STAYS * (whole @ whole))


def _slower_does_better(balance: InputBalance, index: int) -> bool:
    """Return whether a wave of fewer periods than any that has a name leaves less."""
    trajectory = balance.design.trajectory
    if trajectory.turns <= 0.0 or balance.terms[index].shape[0] * trajectory.turns > CLOSE:
        return False
    span = balance.span(index)
    others = orthonormal(np.delete(balance.columns, range(span.start, span.stop), axis=1))
    target = trajectory.target - others @ (others.T @ trajectory.target)
    slow = [Term(law=balance.terms[index].law, shape=(float(n) / trajectory.turns,))
            for n in np.arange(1.0, LEAST_PERIODS, 0.25)]
    most = max(squares_taken(balance.design.columns(term), others, target) for term in slow)
    return most > squares_taken(balance.columns[:, span], others, target)


def _at_several_speeds(phase: np.ndarray, speed: np.ndarray) -> bool:
    """Return whether most phases are passed in several of the bins of the speed."""
    edges = np.quantile(speed, np.linspace(0.0, 1.0, SPEEDS + 1)[1:-1])
    of_speed = np.searchsorted(edges, speed)
    of_phase = np.minimum((phase / (2.0 * np.pi) * PHASES).astype(int), PHASES - 1)
    counts = np.zeros((PHASES, SPEEDS))
    np.add.at(counts, (of_phase, of_speed), 1.0)
    passed = counts[counts.any(axis=1)]  # an arm may swing over a part of its turn alone
    return bool(np.mean(np.sum(passed > 0.0, axis=1) >= SEVERAL) >= MOST_PHASES)
