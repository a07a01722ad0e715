"""When an effect counts: what is there, complete, clearly better, or alone in explaining a record.

The numbers are costs: sums of squares of whitened residuals, in units of what a complete model
leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.measure.tolerances import TOLERANCES
from ema_identification.actuator.naming.answer import LARGEST_SET, Answer, rivals_of
from ema_identification.actuator.naming.contest import Arena
from ema_identification.actuator.naming.estimates import QUANTILE, covariance_of
from ema_identification.actuator.surrogate.catalogue import ALIASES, TAKES_AWAY
from ema_identification.actuator.surrogate.evidence import Evidence
from ema_identification.actuator.surrogate.fit import EffectTerm, Fit
from ema_identification.actuator.surrogate.likelihood import Recalibration
from ema_identification.result import Outcome

CLEARLY_THERE = 4.0
"""Standard deviations by which an effect among two is away from none: it was picked from the whole
catalogue, at all sizes and phases, so that 1.6 of them mean little."""
NOTHING = 0.05
"""Coordinate that counts as none, of the smallest that the library holds."""


def needed(fit: Fit, usual: float) -> bool:
    """Whether every effect of a fit is clearly there: away from none by more than its error.

    `usual` is the cost that a complete model leaves. An effect that acts on the number of a
    tolerance has the width of that in its error; `absorbed` asks whether it leaves it.
    """
    for index, term in enumerate(fit.terms):
        known = [k for k, levels in enumerate(term.signature.levels) if len(levels) > 1]
        matrix = covariance_of(fit, index, usual)[np.ix_(known, known)]
        u = term.u[known]
        least = QUANTILE if (term.variant.name, 0) in ALIASES else CLEARLY_THERE
        if float(u @ np.linalg.solve(matrix + 1e-30 * np.eye(len(u)), u)) < least**2:
            return False
    return True


def absorbed(evidence: Evidence, term: EffectTerm, z: np.ndarray) -> np.ndarray | None:
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


def _total(term: EffectTerm, u: float, sense: float, tolerance: float) -> float:
    """Return the deviation of a number that an effect and a tolerance move together."""
    if sense == 0.0:
        return u + tolerance
    if sense > 0.0:
        return (1.0 + u) * (1.0 + tolerance) - 1.0
    if term.variant.effect in TAKES_AWAY:
        return (1.0 - u) * (1.0 + tolerance) - 1.0
    return (1.0 + tolerance) / (1.0 + u) - 1.0


COMPLETE = 1.45
"""Cost up to which a model counts as complete, in units of what an effect-free unit leaves."""
ALONE = 0.3
"""Misfit above a complete model's, of that which the next best name leaves, up to which a fit
that is not complete is named nevertheless."""
FELL = 0.3
"""The same, of that without an effect."""
FARTHEST = 8.0
"""Largest cost, in units of a complete model's, of a fit that is named."""
EITHER = 2.0
"""Cost of the better effect of a pair alone, in units of the pair's, that shows both."""
SECOND_GAIN = 250.0
"""Least gain of a second effect: the costs of complete models differ by some 170 among units."""


class Case(NamedTuple):
    """What the decisions on one unit share."""

    arena: Arena
    null: Recalibration
    gain: float
    p: float
    without: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of features."""
        return self.arena.evidence.size

    @property
    def usual(self) -> float:
        """Cost that a complete model leaves."""
        return self.arena.evidence.usual

    def p_of(self, without: float, fit: Fit) -> float:
        """Return the probability that a useless effect lowers the cost `without` it as much."""
        scale = self.arena.evidence.blocks[0].library.scale
        return scale.p_gain((without - fit.cost) / max(fit.cost / self.size, 1e-9))

    def complete(self, fit: Fit) -> bool:
        """Whether a fit leaves hardly more than a complete model."""
        return fit.cost < COMPLETE * self.usual

    def helps(self, pair: Fit, singles: Sequence[Fit]) -> bool:
        """Whether two effects lower the misfit clearly below that of the best single one."""
        single = singles[0].cost if singles else np.inf
        return single - pair.cost > SECOND_GAIN * pair.cost / self.size

    def surely(self, pair: Fit, singles: Sequence[Fit]) -> bool:
        """Whether two effects help more than runs of the single one differ among themselves."""
        rule, evidence = self.arena.scattering(singles[0]), self.arena.evidence
        one, two = (rule.cost(evidence, f.mean, f.z) for f in (singles[0], pair))
        return one - two > SECOND_GAIN * max(two, self.usual) / self.size

    def distinct(self, pair: Fit, singles: Sequence[Fit]) -> bool:
        """Whether both effects are there, and none of them is what its tolerance could be.

        Where either of them alone leaves much more than the pair, no error of the coordinates
        says otherwise.
        """
        names = {t.variant.effect for t in pair.terms}
        alone = [f.cost for f in singles if f.terms[0].variant.effect in names]
        clear = bool(alone) and min(alone) > EITHER * pair.cost
        return (clear or needed(pair, self.usual)) and all(
            absorbed(self.arena.evidence, t, pair.z) is None for t in pair.terms)

    def stands_out(self, fit: Fit, others: Sequence[Fit]) -> bool:
        """Whether a fit leaves little of what everything else and the model before leave.

        Entries that merely imitate something unknown come in crowds; the right one stands alone.
        """
        names = {t.variant.effect for t in fit.terms}
        rest = [f.cost for f in others if {t.variant.effect for t in f.terms} != names]
        above = fit.cost - self.usual
        return (fit.cost < FARTHEST * self.usual
                and above < FELL * (self.arena.null_cost - self.usual)
                and above < ALONE * (min(rest, default=np.inf) - self.usual))


def one_effect(case: Case, verdict: Outcome, singles: Sequence[Fit]) -> Answer:
    """Return the best of `singles` with what it might be instead; unknown where that is much."""
    rivals = rivals_of(singles, case.arena.null_cost, case.size)
    if len(rivals) >= LARGEST_SET:
        names = ", ".join(f.terms[0].variant.effect for f in (singles[0], *rivals))
        return Answer(
            verdict="unknown effect", fits=tuple(singles), gain=case.gain,
            null_cost=case.arena.null_cost, equivalent=((singles[0], *rivals),), reasons=(
                f"something is missing, and {len(rivals) + 1} effects explain it equally well: "
                f"{names}",))
    return Answer(
        verdict=verdict, fit=singles[0], fits=tuple(singles), gain=case.gain,
        null_cost=case.arena.null_cost, equivalent=(rivals,),
        p_value=(case.p_of(case.arena.null_cost, singles[0]),))
