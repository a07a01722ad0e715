"""The decision: nothing missing, one effect, two, or one that the catalogue does not hold.

Where the control law can be measured by itself, the decision keeps within what it leaves open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import combine_pvalues

from ema_identification.actuator.measure.runs import Progress, silent
from ema_identification.actuator.naming.answer import LARGEST_SET, Answer, margin_of
from ema_identification.actuator.naming.contest import Arena
from ema_identification.actuator.naming.control_law import ControlLaw, check_law
from ema_identification.actuator.naming.criteria import Case, absorbed, one_effect
from ema_identification.actuator.naming.proposal import (
    challengers,
    pairs_of,
    propose,
    rescaled,
    seconds,
    twins,
)
from ema_identification.actuator.surrogate.evidence import Evidence
from ema_identification.actuator.surrogate.fit import EffectTerm, Fit, Start
from ema_identification.actuator.surrogate.likelihood import Recalibration

NEARLY = 2.0
"""Cost of one effect of a pair, in units of the pair's, from which its fit goes on."""


def with_second(case: Case, singles: Sequence[Fit]) -> Answer:
    """Return one effect that explains the record, with a second one where that helps clearly."""
    best, evidence = singles[0], case.arena.evidence
    one = one_effect(case, "explained", singles)
    if best.cost < case.usual or one.fit is None:
        return one
    more = seconds(evidence, best, without=case.without)[:1]
    if not more:
        return one
    term = EffectTerm(variant=more[0].signature.variant, signature=more[0].signature, u=more[0].u)
    found = case.arena.fits([Start((*best.terms, term), best.z)], first=1)
    if not found:
        return one
    both = found[0]
    if not case.helps(both, singles):
        return one
    alone = each_alone(case, both)
    if not (case.distinct(both, alone) and case.helps(both, alone) and case.surely(both, alone)):
        return one_effect(case, "explained", sorted([*alone, *singles], key=lambda f: f.cost))
    return with_pair(case, one, both, sorted([*alone, *singles], key=lambda f: f.cost),
                     (one.equivalent[0], ()))


def each_alone(case: Case, pair: Fit) -> list[Fit]:
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
    answer = Answer(verdict="explained", fits=tuple(singles), gain=case.gain, null_cost=null_cost)
    return with_pair(case, answer, best, singles, (tuple(equal[0][:2]), tuple(equal[1][:2])))


def with_pair(
    case: Case, answer: Answer, pair: Fit, singles: Sequence[Fit],
    equivalent: tuple[tuple[Fit, ...], tuple[Fit, ...]],
) -> Answer:
    """Return the answer with two effects, each with its own p-value beside the other alone.

    Parameters
    ----------
    case, answer : of the unit; verdict and candidates stay.
    pair : the fit.
    singles : best first; an effect of the pair that is not among them is fitted.
    equivalent : for each effect, fits that cannot be told from it.
    """
    names = [t.variant.effect for t in pair.terms]
    if not set(names) <= {f.terms[0].variant.effect for f in singles}:
        singles = sorted([*each_alone(case, pair), *singles], key=lambda f: f.cost)
    alone = tuple(next((f for f in singles if f.terms[0].variant.effect == name), None)
                  for name in names)
    return replace(answer, fit=pair, alone=alone, equivalent=equivalent, p_value=tuple(
        case.p_of(np.inf if other is None else other.cost, pair) for other in alone[::-1]))


LEVEL_OF_GAIN = 0.002
"""A gain that useless effects reach more often names nothing."""
POOR_FIT = 1e-7
"""A cost this improbable is a disagreement even if no effect of the catalogue helps."""
TOGETHER = 1e-4
"""A gain and a cost that are as improbable together are one (Fisher's method), neither alone."""
TINY = 1e-300
LEFT = "what is left is more than noise; no further effect takes it away"
TIE = 1.3
"""Cost, in units of the best one's, up to which a fit goes on before the two are compared."""
OTHER_FORM = 2.0
"""The same for another form of the same effects."""
AHEAD = 0.8
"""Cost of the best effect, in units of the next one's, up to which it is looked around."""
PROMISING = 0.98
"""Cost of the best pair, in units of the best effect's alone, from which it is looked around."""
LOOKED_AROUND = 2
"""Pairs that are looked around where they nearly tie."""
SLIGHT = 400.0
"""Gain up to which an effect counts as small: more of the catalogue is tried against it."""
SLIGHT_COST = 4.0
"""Cost without an effect, in units of a complete model's, up to which the same holds."""


def agrees(p_gain: float, p_null: float) -> bool:
    """Whether nothing is missing, by two probabilities when nothing is: of gain and of cost."""
    together = combine_pvalues(np.maximum([p_gain, p_null], TINY)).pvalue
    return bool(p_gain > LEVEL_OF_GAIN and p_null > POOR_FIT and together > TOGETHER)


def decide(
    evidence: Evidence, null: Recalibration, *, without: Sequence[str] = (),
    progress: Progress = silent, seed: int = 0,
) -> Answer:
    """Return the answer to a recalibrated model's residual."""
    scale, size = evidence.blocks[0].library.scale, evidence.size
    proposal = propose(evidence, null, without=without, seed=seed)
    p_gain = scale.p_gain(proposal.gain)
    p_null = scale.p_fit(null.cost / evidence.usual * float(np.exp(scale.fit[0])))
    if agrees(p_gain, p_null):
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
        if gained < SLIGHT and arena.null_cost < SLIGHT_COST * evidence.usual:
            finished = [f for f in singles if not f.left_behind]
            more = challengers(evidence, finished, without=without)
            singles = sorted([*singles, *arena.fits(more, first=1)], key=lambda f: f.cost)
    case = Case(arena, null, proposal.gain, p_gain, tuple(without))
    if singles and case.complete(singles[0]):
        return with_second(case, _close_ones_polished(case, _with_twins(case, singles)))
    if singles:
        singles = _at_other_sizes(case, singles, progress, seed)
        if not case.complete(singles[0]) and singles[0].cost < AHEAD * _next_name(singles):
            singles = sorted([arena.refined(singles[0]), *singles], key=lambda f: f.cost)
        if case.complete(singles[0]):
            return with_second(case, _with_twins(case, singles))
    found = arena.fits(pairs_of(evidence, singles, without=without, seed=seed),
                       progress=progress, span=(0.7, 0.9))
    if found and singles and found[0].cost > PROMISING * singles[0].cost:
        found = []
    if found and not case.complete(found[0]):
        found = sorted([*_refined(case, found), *found], key=lambda f: f.cost)
    found = [f for f in found if case.helps(f, singles)]
    if found:
        singles = sorted([*each_alone(case, found[0]), *singles], key=lambda f: f.cost)
    pairs = [f for f in found if case.helps(f, singles) and case.distinct(f, singles)]
    if singles and case.complete(singles[0]):
        pairs = [f for f in pairs[:1] if case.surely(f, singles)]
    if pairs and case.complete(pairs[0]):
        return two_effects(case, pairs, singles)
    if singles and case.complete(singles[0]):
        return one_effect(case, "explained", singles)
    if pairs and case.stands_out(pairs[0], [*singles, *found]):
        return replace(two_effects(case, pairs, singles), verdict="partly explained",
                       reasons=(LEFT,))
    if singles and case.stands_out(singles[0], singles[1:]):
        return replace(one_effect(case, "partly explained", singles), reasons=(LEFT,))
    return Answer(
        verdict="unknown effect", fits=tuple(singles), gain=proposal.gain,
        null_cost=arena.null_cost, reasons=(
            f"something is missing: cost {arena.null_cost / size:.1f} a feature after "
            f"recalibration, {case.usual / size:.1f} is usual",
            "no effect of the catalogue, and no two, explain it: the best leaves "
            + (f"{singles[0].cost / size:.1f}" if singles else "everything"),
        ))


def _next_name(singles: Sequence[Fit]) -> float:
    """Return the cost of the best fit of another effect than the first one's."""
    first = singles[0].terms[0].variant.effect
    return min((f.cost for f in singles if f.terms[0].variant.effect != first), default=np.inf)


def _at_other_sizes(
    case: Case, singles: Sequence[Fit], progress: Progress, seed: int
) -> list[Fit]:
    """Return the fits, with further ones of the best effects from other sizes, best first."""
    arena = case.arena
    starts = rescaled(arena.evidence, arena.metrics[0], singles, seed=seed)
    return sorted([*singles, *arena.fits(starts, progress=progress, span=(0.6, 0.7))],
                  key=lambda f: f.cost)


def _refined(case: Case, pairs: Sequence[Fit]) -> list[Fit]:
    """Return the best pair looked around, and the next best where the two nearly tie.

    Another form of the same two effects (a short with and without its resistance) is next too.
    """
    found: list[Fit] = []
    first: dict[frozenset[str], Fit] = {}
    best = {t.variant.effect for t in pairs[0].terms}
    for fit in pairs:
        same = {t.variant.effect for t in fit.terms} == best
        if fit.cost < (OTHER_FORM if same else TIE) * pairs[0].cost:
            first.setdefault(frozenset(t.variant.name for t in fit.terms), fit)
    for fit in list(first.values())[:LOOKED_AROUND]:
        found.append(case.arena.refined(fit))
        if case.complete(found[-1]):
            break
    return found


def _with_twins(case: Case, singles: Sequence[Fit]) -> list[Fit]:
    """Return the fits, with those of an effect that makes nearly the best one's machine.

    Of several records only, of which the later ones are there to tell such effects apart. On one
    record the two fits differ by less than either may be off.
    """
    if len(case.arena.evidence.blocks) == 1:
        return list(singles)
    starts = twins(case.arena.evidence, singles[0], without=case.without)
    return sorted([*singles, *case.arena.fits(starts, first=1)], key=lambda f: f.cost)


def _close_ones_polished(case: Case, singles: Sequence[Fit]) -> list[Fit]:
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


def decide_lawfully(
    evidence: Evidence, null: Recalibration, *, without: Sequence[str] = (),
    progress: Progress = silent, seed: int = 0,
) -> tuple[Answer, ControlLaw | None]:
    """Return the answer to a recalibrated model's residual, and what the control law said.

    Where the law holds no effect of the controller is a candidate; where it does not, the answer
    holds an effect that changes it as measured, or it is unknown.
    """
    law = check_law(evidence, without=without, seed=seed)
    if law is None:
        return decide(evidence, null, without=without, progress=progress, seed=seed), None
    unknown = Answer(verdict="unknown effect", null_cost=null.cost, reasons=(
        "no effect of the catalogue changes the control law as it was measured",))
    if not law.holds and not law.suspects:
        return unknown, law
    answer = decide(evidence, null, without=(*without, *law.excluded), progress=progress,
                    seed=seed)
    if law.holds or (answer.fit is not None and any(
            t.variant.effect in law.suspects for t in answer.fit.terms)):
        return answer, law
    return replace(unknown, null_cost=answer.null_cost, gain=answer.gain, reasons=(
        f"the control law is not the model's; no model with {' or '.join(law.suspects)} explains "
        "the record",)), law
