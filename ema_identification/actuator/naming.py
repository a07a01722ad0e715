"""Name: decide whether anything is missing, what explains it, and what cannot be told apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.refit import Fit, Term, refit
from ema_identification.actuator.screening import Residual, Screened, residual, screen, stacked
from ema_identification.actuator.spread import N_TOLERANCES

LEVEL = 0.005
"""Probability of naming anything when nothing is hidden, aimed at."""
POOR = 3.0
"""A candidate whose first rounds leave this many times the best cost is not polished."""
KEPT = 4
"""Candidates from each of the two screenings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """What scores look like when nothing is hidden.

    Attributes
    ----------
    fit : mean and standard deviation of the log of cost a feature.
    gain : location and scale (exponential tail) of the best candidate's relative gain.
    """

    fit: tuple[float, float] = (math.log(1.45), 0.22)
    gain: tuple[float, float] = (10.0, 4.0)

    def p_gain(self, gain: float) -> float:
        """Return the probability of a larger best gain when nothing is hidden."""
        return float(min(1.0, math.exp(-(gain - self.gain[0]) / self.gain[1])))

    def p_fit(self, cost_a_feature: float) -> float:
        """Return the probability of a larger cost when the model is complete."""
        x = (math.log(max(cost_a_feature, 1e-9)) - self.fit[0]) / self.fit[1]
        return 0.5 * math.erfc(x / math.sqrt(2.0))


def gain_of(rest: Residual, best: Screened, size: int) -> float:
    """Return the fall of the cost by the best candidate, in units of the cost a feature."""
    return (rest.cost - best.cost) / max(best.cost / size, 1e-9)


def propose(
    evidence: Evidence, null: Recalibration, *, without: Sequence[str] = ()
) -> tuple[Residual, list[Screened], list[Screened]]:
    """Return the local residual, its screening, and candidates of both screenings.

    One screening is about runs at the recalibrated tolerances, exact for small effects; the other
    about the nominal unit, for effects so large that recalibration went astray.
    """
    local = residual(evidence, null.centre, null.mean, runs=null.runs)
    near = screen(evidence, local, without=without)
    z = np.zeros(evidence.tolerances.size)
    mean = [b.library.null.mean(np.zeros(N_TOLERANCES), b.conditions) for b in evidence.blocks]
    far = screen(evidence, residual(evidence, z, mean, runs=0), without=without)
    chosen: list[Screened] = []
    for screened in (*far[:KEPT], *near[:KEPT]):
        if all(screened.variant.name != c.variant.name for c in chosen):
            chosen.append(screened)
    return local, near, chosen


def fit_candidates(
    evidence: Evidence, chosen: Sequence[Screened], null: Recalibration, *, seed: int = 0
) -> list[Fit]:
    """Return simulator fits of the candidates, best first."""
    found: list[Fit] = []
    best = np.inf
    for screened in chosen:
        term = Term(variant=screened.variant, signature=stacked(evidence, screened.index),
                    u=screened.u)
        fit = refit(evidence, [term], screened.z, null.mean, seed=seed, give_up=POOR * best)
        best = min(best, fit.cost)
        found.append(fit)
    return sorted(found, key=lambda f: f.cost)
