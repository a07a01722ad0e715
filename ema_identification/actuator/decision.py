"""Decide: nothing missing, one effect, two, or one that the catalogue does not hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.contest import LAST_RUNS, Arena, Start
from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.naming import (
    challengers,
    pairs_of,
    propose,
    rescaled,
    seconds,
)
from ema_identification.actuator.pruning import absorbed, needed
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.refit import Fit, Term
from ema_identification.actuator.runs import Progress, silent
from ema_identification.identification import Outcome

LEVEL = 0.002
"""A gain that useless effects reach more often names nothing."""
POOR_FIT = 1e-7
"""A cost this improbable is a disagreement even if no effect of the catalogue helps."""
COMPLETE = 1.45
"""Cost up to which a model counts as complete, in units of what an effect-free unit leaves."""
ALONE = 0.3
"""Misfit above a complete model's, of that which the next best name leaves, up to which a fit
that is not complete is named nevertheless."""
FELL = 0.3
"""The same, of that without an effect."""
FARTHEST = 8.0
"""Largest cost, in units of a complete model's, of a fit that is named."""
SECOND_GAIN = 250.0
"""Least gain of a second effect: the costs of complete models differ by some 170 among units."""
NEARLY = 2.0
"""Cost of one effect of a pair, in units of the pair's, from which its fit goes on."""
LEFT = "what is left is more than noise; no further effect takes it away"
TIE = 1.3
"""Cost, in units of the best one's, up to which a fit goes on before the two are compared."""
SLIGHT = 400.0
"""Gain up to which an effect counts as small: more of the catalogue is tried against it."""
LARGEST_SET = 3
"""More names that the data cannot tell apart are no answer."""
SET_MARGIN = 14.0
"""Costs that differ by less, in units of the cost a feature, do not tell two effects apart."""
SET_SHARE = (0.02, 0.15)
"""The same, of the misfit that was explained and at most of the cost (error of simulation)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What was decided.

    Attributes
    ----------
    verdict : of the identification.
    fit : of the effects that are added; None for none.
    fits : all single candidates that were fitted, best first.
    equivalent : for each term of `fit`, fits that the data cannot tell from it; without `fit`,
        all fits that cannot be told apart, where they are too many for an answer.
    simpler : where `fit` has two effects, the best fit of one of them alone.
    p_value : for each term, of the hypothesis that it adds nothing.
    gain : of the best candidate on the recalibrated model.
    null_cost : of the recalibrated model, in the metric of the fits.
    reasons : for people.
    """

    verdict: Outcome
    fit: Fit | None = None
    fits: tuple[Fit, ...] = ()
    equivalent: tuple[tuple[Fit, ...], ...] = ()
    simpler: Fit | None = None
    p_value: tuple[float, ...] = ()
    gain: float = 0.0
    null_cost: float = 0.0
    reasons: tuple[str, ...] = ()


class _Case(NamedTuple):
    """What the decisions on one unit share."""

    arena: Arena
    null: Recalibration
    gain: float
    p: float
    without: tuple[str, ...]

    @property
    def size(self) -> int:
        return self.arena.evidence.size

    @property
    def usual(self) -> float:
        """Cost that a complete model leaves."""
        return self.arena.evidence.usual

    def complete(self, fit: Fit) -> bool:
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

    def distinct(self, pair: Fit) -> bool:
        """Whether both effects are there, and none of them is what its tolerance could be."""
        return needed(pair, self.usual) and all(
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


def decide(
    evidence: Evidence, null: Recalibration, *, without: Sequence[str] = (),
    progress: Progress = silent, seed: int = 0,
) -> Answer:
    """Return the answer to a recalibrated model's residual."""
    scale, size = evidence.blocks[0].library.scale, evidence.size
    proposal = propose(evidence, null, without=without, seed=seed)
    p_gain = scale.p_gain(proposal.gain)
    p_null = scale.p_fit(null.cost / evidence.usual * float(np.exp(scale.fit[0])))
    if p_gain > LEVEL and p_null > POOR_FIT:
        return Answer(verdict="no disagreement", gain=proposal.gain, null_cost=null.cost, reasons=(
            f"the best effect of the catalogue would lower the misfit by {proposal.gain:.0f}; "
            f"useless effects reach that with probability {p_gain:.2g}",
            f"cost {null.cost / size:.2f} a feature: a complete model leaves more with "
            f"probability {p_null:.2g}",
        ))
    arena = Arena(evidence, null, seed=seed)
    singles = arena.fits(proposal.starts, progress=progress, span=(0.2, 0.6))
    if singles:  # the fit may gain what the screening, linear, did not see
        gained = (arena.null_cost - singles[0].cost) / max(singles[0].cost / size, 1e-9)
        p_gain = min(p_gain, scale.p_gain(gained))
        if gained < SLIGHT:
            finished = [f for f in singles if f.runs == LAST_RUNS]
            more = challengers(evidence, finished, without=without)
            singles = sorted([*singles, *arena.fits(more, first=1)], key=lambda f: f.cost)
    case = _Case(arena, null, proposal.gain, p_gain, tuple(without))
    if singles and case.complete(singles[0]):
        return _with_second(case, _close_ones_polished(case, singles))
    if singles:
        singles = _at_other_sizes(case, singles, progress, seed)
        if case.complete(singles[0]):
            return _with_second(case, singles)
    found = arena.fits(pairs_of(evidence, singles, without=without, seed=seed),
                       progress=progress, span=(0.7, 0.9))
    found = [f for f in found if case.helps(f, singles)]
    if found and not case.complete(found[0]):
        found = sorted([arena.refined(found[0]), *found], key=lambda f: f.cost)
    if found:
        singles = sorted([*_alone(case, found[0]), *singles], key=lambda f: f.cost)
    pairs = [f for f in found if case.helps(f, singles) and case.distinct(f)]
    if singles and case.complete(singles[0]):
        pairs = [f for f in pairs[:1] if case.surely(f, singles)]
    if pairs and case.complete(pairs[0]):
        return _two(case, pairs, singles)
    if singles and case.complete(singles[0]):
        return _one(case, "explained", singles)
    if pairs and case.stands_out(pairs[0], [*singles, *found]):
        return replace(_two(case, pairs, singles), verdict="partly explained", reasons=(LEFT,))
    if singles and case.stands_out(singles[0], singles[1:]):
        return replace(_one(case, "partly explained", singles), reasons=(LEFT,))
    return Answer(
        verdict="unknown effect", fits=tuple(singles), gain=proposal.gain,
        null_cost=arena.null_cost, reasons=(
            f"something is missing: cost {arena.null_cost / size:.1f} a feature after "
            f"recalibration, {case.usual / size:.1f} is usual",
            "no effect of the catalogue, and no two, explain it: the best leaves "
            + (f"{singles[0].cost / size:.1f}" if singles else "everything"),
        ))


def _at_other_sizes(
    case: _Case, singles: Sequence[Fit], progress: Progress, seed: int
) -> list[Fit]:
    """Return the fits, with further ones of the best effects from other sizes, best first."""
    arena = case.arena
    starts = rescaled(arena.evidence, arena.metrics[0], singles, seed=seed)
    return sorted([*singles, *arena.fits(starts, progress=progress, span=(0.6, 0.7))],
                  key=lambda f: f.cost)


def _close_ones_polished(case: _Case, singles: Sequence[Fit]) -> list[Fit]:
    """Return the fits, those that nearly tie for the first place gone on with, best first."""
    first: dict[str, Fit] = {}
    for fit in singles:
        if fit.cost < TIE * singles[0].cost:
            first.setdefault(fit.terms[0].variant.effect, fit)
    close = list(first.values())[:LARGEST_SET]
    if len(close) < 2:
        return list(singles)
    others = [f for f in singles if all(f is not c for c in close)]
    return sorted([*map(case.arena.polished, close), *others], key=lambda f: f.cost)


def _margin(best: Fit, null_cost: float, size: int) -> float:
    explained = max(0.0, null_cost - best.cost)
    return SET_MARGIN * best.cost / size + min(
        SET_SHARE[0] * explained, SET_SHARE[1] * best.cost)


def _rivals(fits: Sequence[Fit], null_cost: float, size: int) -> tuple[Fit, ...]:
    """Return fits of other effects that are as good as the first."""
    best, found = fits[0], []
    names = {best.terms[-1].variant.effect}
    for fit in fits[1:]:
        name = fit.terms[-1].variant.effect
        if name not in names and fit.cost - best.cost < _margin(best, null_cost, size):
            names.add(name)
            found.append(fit)
    return tuple(found)


def _one(case: _Case, verdict: Outcome, singles: Sequence[Fit]) -> Answer:
    rivals = _rivals(singles, case.arena.null_cost, case.size)
    if len(rivals) >= LARGEST_SET:
        names = ", ".join(f.terms[0].variant.effect for f in (singles[0], *rivals))
        return Answer(
            verdict="unknown effect", fits=tuple(singles), gain=case.gain,
            null_cost=case.arena.null_cost, equivalent=((singles[0], *rivals),), reasons=(
                f"something is missing, and {len(rivals) + 1} effects explain it equally well: "
                f"{names}",))
    return Answer(
        verdict=verdict, fit=singles[0], fits=tuple(singles), gain=case.gain,
        null_cost=case.arena.null_cost, p_value=(case.p,), equivalent=(rivals,))


def _with_second(case: _Case, singles: Sequence[Fit]) -> Answer:
    """Return one effect that explains the record, with a second one where that helps clearly."""
    best, evidence = singles[0], case.arena.evidence
    one = _one(case, "explained", singles)
    if best.cost < case.usual or one.fit is None:
        return one
    more = seconds(evidence, best, without=case.without)[:1]
    if not more:
        return one
    term = Term(variant=more[0].signature.variant, signature=more[0].signature, u=more[0].u)
    found = case.arena.fits([Start((*best.terms, term), best.z)], first=1)
    if not found:
        return one
    both = found[0]
    if not case.helps(both, singles):
        return one
    alone = _alone(case, both)
    if not (case.distinct(both) and case.helps(both, alone) and case.surely(both, alone)):
        return _one(case, "explained", sorted([*alone, *singles], key=lambda f: f.cost))
    fell = (best.cost - both.cost) / max(both.cost / case.size, 1e-9)
    scale = evidence.blocks[0].library.scale
    return replace(one, fit=both, simpler=best, equivalent=(one.equivalent[0], ()),
                   p_value=(case.p, scale.p_gain(fell)))


def _two(case: _Case, pairs: Sequence[Fit], singles: Sequence[Fit]) -> Answer:
    """Return two effects, with what either might be instead."""
    best, null_cost = pairs[0], case.arena.null_cost
    names = [t.variant.effect for t in best.terms]
    equal: list[list[Fit]] = [[], []]
    for fit in pairs[1:]:
        if fit.cost - best.cost > _margin(best, null_cost, case.size):
            continue
        other = [t.variant.effect for t in fit.terms]
        for k in (0, 1):
            kept, moved = names[1 - k], [n for n in other if n != names[1 - k]]
            if kept in other and len(moved) == 1 and moved[0] != names[k]:
                equal[k].append(fit)
    return Answer(verdict="explained", fit=best, fits=tuple(singles), gain=case.gain,
                  null_cost=null_cost, p_value=(case.p, case.p),
                  simpler=next((f for f in singles if f.terms[0].variant.effect in names), None),
                  equivalent=(tuple(equal[0][:2]), tuple(equal[1][:2])))


def _alone(case: _Case, pair: Fit) -> list[Fit]:
    """Return fits of each effect of a pair alone, best first.

    They start where the pair ended, so single fits that had stopped short are mended too.
    """
    found: list[Fit] = []
    for term, other in (pair.terms, pair.terms[::-1]):
        z = absorbed(case.arena.evidence, other, pair.z)
        for fit in case.arena.fits([Start((term,), pair.z if z is None else z)], first=1):
            near = fit.cost < NEARLY * pair.cost
            found.append(case.arena.polished(fit) if near else fit)
    return sorted(found, key=lambda f: f.cost)
