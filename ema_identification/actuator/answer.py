"""The answer on a unit, and the sets of names that its data cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ema_identification.actuator.case import Case
from ema_identification.actuator.fit import Fit
from ema_identification.identification import Outcome

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


def margin_of(best: Fit, null_cost: float, size: int) -> float:
    """Return by how much the cost of a fit must be above the best one's to be told from it.

    Parameters
    ----------
    best : the best fit.
    null_cost : cost without an effect.
    size : number of features.
    """
    explained = max(0.0, null_cost - best.cost)
    return SET_MARGIN * best.cost / size + min(
        SET_SHARE[0] * explained, SET_SHARE[1] * best.cost)


def rivals_of(fits: Sequence[Fit], null_cost: float, size: int) -> tuple[Fit, ...]:
    """Return fits of other effects that are as good as the first."""
    best, found = fits[0], []
    names = {best.terms[-1].variant.effect}
    for fit in fits[1:]:
        name = fit.terms[-1].variant.effect
        if name not in names and fit.cost - best.cost < margin_of(best, null_cost, size):
            names.add(name)
            found.append(fit)
    return tuple(found)


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
        null_cost=case.arena.null_cost, p_value=(case.p,), equivalent=(rivals,))


def two_effects(case: Case, pairs: Sequence[Fit], singles: Sequence[Fit]) -> Answer:
    """Return two effects, with what either might be instead."""
    best, null_cost = pairs[0], case.arena.null_cost
    names = [t.variant.effect for t in best.terms]
    equal: list[list[Fit]] = [[], []]
    for fit in pairs[1:]:
        if fit.cost - best.cost > margin_of(best, null_cost, case.size):
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
