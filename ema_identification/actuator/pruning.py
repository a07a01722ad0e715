"""Prune: whether each of two effects is needed, by its size, its band and held-out records."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.aliases import ALIASES, TAKES_AWAY
from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.fit import Fit, Term
from ema_identification.actuator.parameters import QUANTILE, covariance_of
from ema_identification.actuator.spread import TOLERANCES

CLEARLY = 4.0
"""Standard deviations by which an effect among two is away from none: it was picked from the whole
catalogue, at all sizes and phases, so that 1.6 of them mean little."""
NOTHING = 0.05
"""Coordinate that counts as none, of the smallest that the library holds."""
SUFFICIENT = 2.0
"""Cost, in units of a complete model's, up to which one effect may do without a second."""
TELLS = 10.0
"""Sum of squares by which two models must differ on held-out records before those decide."""
MOST = 10.0
"""Most that one held-out feature counts (standard deviations)."""


def needed(fit: Fit, usual: float) -> bool:
    """Whether every effect of a fit is clearly there: away from none by more than its error.

    `usual` is the cost that a complete model leaves. An effect that acts on the number of a
    tolerance has the width of that in its error; `absorbed` asks whether it leaves it.
    """
    for index, term in enumerate(fit.terms):
        known = [k for k, levels in enumerate(term.signature.levels) if len(levels) > 1]
        matrix = covariance_of(fit, index, usual)[np.ix_(known, known)]
        u = term.u[known]
        least = QUANTILE if (term.variant.name, 0) in ALIASES else CLEARLY
        if float(u @ np.linalg.solve(matrix + 1e-30 * np.eye(len(u)), u)) < least**2:
            return False
    return True


def absorbed(evidence: Evidence, term: Term, z: np.ndarray) -> np.ndarray | None:
    """Return tolerances that do what an effect does, or None if they would leave their bands.

    A friction that is 8 % high is a tolerance; one that is 30 % high is an effect.

    Parameters
    ----------
    evidence : the records.
    term : the effect.
    z : tolerances beside it, in half widths.
    """
    names, places = [t.name for t in TOLERANCES], np.arange(len(z))
    found = z.copy()
    for k, u in enumerate(term.u):
        alias = ALIASES.get((term.variant.name, k))
        if alias is None:
            levels = np.abs(term.signature.levels[k])
            if abs(u) > NOTHING * levels[levels > 0.0].min(initial=np.inf):
                return None
            continue
        j = names.index(alias[0])
        width = TOLERANCES[j].half_width
        for record in range(len(evidence.blocks)):
            place = int(evidence.tolerances.of(record, places)[j])
            total = _total(term, float(u), alias[1], width * float(z[place]))
            if abs(total) > width:
                return None
            found[place] = total / width
    return found


def _total(term: Term, u: float, sense: float, tolerance: float) -> float:
    """Return the deviation of a number that an effect and a tolerance move together."""
    if sense == 0.0:
        return u + tolerance
    if sense > 0.0:
        return (1.0 + u) * (1.0 + tolerance) - 1.0
    if term.variant.effect in TAKES_AWAY:
        return (1.0 - u) * (1.0 + tolerance) - 1.0
    return (1.0 + tolerance) / (1.0 + u) - 1.0


def sufficient(evidence: Evidence, simpler: Fit) -> bool:
    """Whether a fit with one effect is so good that held-out records may speak for it.

    Where it leaves much of the fitted record, the second effect is there, however little of it
    a held-out record shows.
    """
    return simpler.cost < SUFFICIENT * evidence.usual


def refuted(simpler: Sequence[np.ndarray], fuller: Sequence[np.ndarray]) -> bool:
    """Whether held-out records speak against an effect more.

    Parameters
    ----------
    simpler, fuller : residuals of the held-out records without and with it, in standard
        deviations. Where the two models predict the same, the records say nothing.
    """
    a, b = np.concatenate(list(simpler)), np.concatenate(list(fuller))
    a, b = np.clip(a, -MOST, MOST), np.clip(b, -MOST, MOST)
    return bool(np.sum((a - b)**2) > TELLS and np.sum(a**2) <= np.sum(b**2))
