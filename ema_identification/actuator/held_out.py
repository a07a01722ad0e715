"""Show: the gap on data that took no part in the fit, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.evidence import SHARED, Evidence, Tolerances, noise_covariance
from ema_identification.actuator.spread import PRIOR, TOLERANCES
from ema_sim.effects import Effects

RUNS = 8


class Gap(NamedTuple):
    """A gap, and what it is when nothing is missing."""

    value: float
    floor: float


def gap_of(
    evidence: Evidence, held: Evidence | None, z: np.ndarray, centre: np.ndarray,
    mean: Sequence[np.ndarray], effects: Effects | None, *, seed: int,
) -> Gap:
    """Return the gap of a model.

    Parameters
    ----------
    evidence : the records of the fit.
    held : held-out records; None takes the records of the fit.
    z : fitted tolerances.
    centre, mean : where the records of the fit were simulated, and their features.
    effects : of the model, None for its own.
    seed : of the runs on held-out records.
    """
    if held is None:
        parts = [
            (b.values - f - slope @ (z - centre)) / np.sqrt(np.diag(noise_covariance(b, runs=RUNS)))
            for b, f, slope in zip(evidence.blocks, mean, evidence.slopes(centre))
        ]
        return Gap(float(np.sqrt(np.mean(np.concatenate(parts)**2))), 1.0)
    shared = evidence.tolerances.of(0, z)
    total = []
    tolerances = Tolerances(len(held.blocks))
    for k, block in enumerate(held.blocks):
        own = np.zeros(tolerances.size)
        full = tolerances.of(k, own)
        full[SHARED] = shared[SHARED]
        z_k = np.zeros(held.tolerances.size)
        for j, column in enumerate(np.flatnonzero(
                held.tolerances.spread(k, np.eye(len(TOLERANCES))).any(axis=0))):
            z_k[column] = full[j]
        f = held.mean(z_k, effects, runs=RUNS, seed=seed + 100)[k]
        slope = block.library.null.slope(full, block.conditions)
        noise = np.diag(noise_covariance(block, runs=RUNS)).copy()
        day = [j for j, t in enumerate(TOLERANCES) if not t.shared]
        noise += PRIOR**2 * (slope[:, day]**2).sum(axis=1)
        total.append((block.values - f) / np.sqrt(noise))
    return Gap(float(np.sqrt(np.mean(np.concatenate(total)**2))), 1.0)
