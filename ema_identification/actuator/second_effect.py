"""A second effect beside one that explains a record, and each effect of a pair alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ema_identification.actuator.answer import Answer, one_effect
from ema_identification.actuator.case import Case
from ema_identification.actuator.contest import Start
from ema_identification.actuator.fit import Fit, Term
from ema_identification.actuator.naming import seconds
from ema_identification.actuator.pruning import absorbed

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
    term = Term(variant=more[0].signature.variant, signature=more[0].signature, u=more[0].u)
    found = case.arena.fits([Start((*best.terms, term), best.z)], first=1)
    if not found:
        return one
    both = found[0]
    if not case.helps(both, singles):
        return one
    alone = each_alone(case, both)
    if not (case.distinct(both, alone) and case.helps(both, alone) and case.surely(both, alone)):
        return one_effect(case, "explained", sorted([*alone, *singles], key=lambda f: f.cost))
    fell = (best.cost - both.cost) / max(both.cost / case.size, 1e-9)
    scale = evidence.blocks[0].library.scale
    return replace(one, fit=both, simpler=best, equivalent=(one.equivalent[0], ()),
                   p_value=(case.p, scale.p_gain(fell)))


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
