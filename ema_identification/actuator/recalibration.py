"""Recalibrate: move the parameters that the model has, within their tolerances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_identification.actuator.bounded import bounded_least_squares
from ema_identification.actuator.evidence import (
    Evidence,
    Whitening,
    noise_covariance,
    slope_noise,
    solve,
)

ROUNDS = 3
"""Simulations at improved tolerances."""
RUNS = 3
"""Runs a simulation; the last has `LAST_RUNS`."""
LAST_RUNS = 12
COARSE = 0.2
"""Share of the residual granted as error in the first round; halves a round."""
BAND = 1.0
"""Bound of a tolerance (half widths)."""
WEIGHT = 1.0
"""Of the square of a tolerance in the cost: their bounds do the rest."""
TINY = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Recalibration:
    """The best that the model does without a new effect.

    Attributes
    ----------
    z : ndarray. Tolerances in half widths (`Evidence.tolerances`).
    centre : ndarray. Where `mean` was simulated.
    covariance : ndarray, of `z`.
    mean : simulated features of each record at `centre`.
    cost : sum of squares of the whitened residual, prior included.
    runs : of the last simulation.
    """

    z: np.ndarray
    centre: np.ndarray
    covariance: np.ndarray
    mean: tuple[np.ndarray, ...]
    cost: float
    runs: int

    @property
    def free(self) -> int:
        """Number of coordinates of effects: none."""
        return 0


def recalibrate(
    evidence: Evidence, *, rounds: int = ROUNDS, runs: int = RUNS, last: int = LAST_RUNS,
    seed: int = 0,
) -> Recalibration:
    """Fit the tolerances: first on the library, then on runs at the fitted values."""
    z = np.zeros(evidence.tolerances.size)
    for _ in range(2):
        mean = [b.library.null.mean(evidence.tolerances.of(i, z), b.conditions)
                for i, b in enumerate(evidence.blocks)]
        z, _, _ = _solve(evidence, z, mean, 0, COARSE)
    for k in range(rounds):
        n = last if k == rounds - 1 else runs
        mean = evidence.mean(z, None, runs=n, seed=seed + k)
        if k == rounds - 1:
            break
        z, _, _ = _solve(evidence, z, mean, n, COARSE * 0.5**k)
    return solve_at(evidence, z, mean, last)


def solve_at(
    evidence: Evidence, centre: np.ndarray, mean: list[np.ndarray], runs: int
) -> Recalibration:
    """Return the recalibration that follows from one simulation at tolerances `centre`."""
    z, covariance, cost = _solve(evidence, centre, mean, runs, 0.0)
    return Recalibration(z=z, centre=centre, covariance=covariance, mean=tuple(mean), cost=cost,
                         runs=runs)


def _solve(
    evidence: Evidence, z: np.ndarray, mean: list[np.ndarray], runs: int, coarse: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return tolerances within their bands, their covariance and the cost."""
    rows, target, feigned = [], [], 0.0
    for block, f, slope in zip(evidence.blocks, mean, evidence.slopes(z)):
        noise = noise_covariance(block, runs=runs, error=coarse * (block.values - f))
        feigned += slope_noise(block, noise)
        white = Whitening(noise)
        rows.append(white(slope))
        target.append(white(block.values - f))
    columns, rest = np.vstack(rows), np.concatenate(target)
    _, covariance, _ = solve(columns, rest, z, 0, feigned)
    step = bounded_least_squares(
        columns, rest, -BAND - z - TINY, BAND - z + TINY, np.full(len(z), WEIGHT), z)
    rest = rest - columns @ step
    found = np.clip(z + step, -BAND, BAND)
    return found, covariance, float(rest @ rest + WEIGHT * (found @ found))
