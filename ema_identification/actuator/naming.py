"""Name: decide whether anything is missing, what explains it, and what cannot be told apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.periodic import periodic_candidates
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.refit import Fit, Term, refit
from ema_identification.actuator.screening import (
    Residual,
    Screened,
    residual,
    screen,
    signature_of,
)
from ema_identification.actuator.spread import N_TOLERANCES

LEVEL = 0.005
"""Probability of naming anything when nothing is hidden, aimed at."""
POOR = 3.0
"""A candidate whose first rounds leave this many times the best cost is not polished."""
KEPT = 3
"""Candidates from each of the two screenings."""


class Proposal(NamedTuple):
    """Residuals about the recalibrated and the nominal unit, and what might explain them."""

    near: Residual
    far: Residual
    screened: list[Screened]
    """All variants against `near`, best first."""
    chosen: list[Screened]
    """Candidates for the simulator."""


def gain_of(rest: Residual, best: Screened, size: int) -> float:
    """Return the fall of the cost by the best candidate, in units of the cost a feature."""
    return (rest.cost - best.cost) / max(best.cost / size, 1e-9)


def propose(
    evidence: Evidence, null: Recalibration, *, without: Sequence[str] = (), seed: int = 0
) -> Proposal:
    """Return residuals, the screening of the near one, and candidates of both.

    One screening is about runs at the recalibrated tolerances, exact for small effects; the other
    about the nominal unit, for effects so large that recalibration went astray.
    """
    local = residual(evidence, null.centre, null.mean, runs=null.runs)
    near = screen(evidence, local, without=without)
    z = np.zeros(evidence.tolerances.size)
    mean = [b.library.null.mean(np.zeros(N_TOLERANCES), b.conditions) for b in evidence.blocks]
    wide = residual(evidence, z, mean, runs=0)
    far = screen(evidence, wide, without=without)
    chosen: list[Screened] = []
    for screened in (*far[:KEPT], *near[:KEPT]):
        if all(screened.variant.name != c.variant.name for c in chosen):
            chosen.append(screened)
    chosen += periodic_candidates(evidence, null, local, without=without, seed=seed)
    return Proposal(near=local, far=wide, screened=near, chosen=chosen)


def fit_candidates(
    evidence: Evidence, chosen: Sequence[Screened], null: Recalibration, *, seed: int = 0
) -> list[Fit]:
    """Return simulator fits of the candidates, best first."""
    found: list[Fit] = []
    best = np.inf
    for screened in chosen:
        term = Term(variant=screened.variant, signature=signature_of(evidence, screened),
                    u=screened.u)
        fit = refit(evidence, [term], screened.z, null.mean, seed=seed, give_up=POOR * best)
        best = min(best, fit.cost)
        found.append(fit)
    return sorted(found, key=lambda f: f.cost)
