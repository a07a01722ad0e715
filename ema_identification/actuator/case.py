"""One unit on trial: what its fits have in common, and when one counts for anything."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.contest import Arena
from ema_identification.actuator.fit import Fit
from ema_identification.actuator.pruning import absorbed, needed
from ema_identification.actuator.recalibration import Recalibration

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
