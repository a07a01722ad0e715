"""What was decided, as the findings and candidates of the result."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.answer import Answer
from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.fit import Fit
from ema_identification.actuator.held_out import Gap
from ema_identification.actuator.parameters import parameters_of
from ema_identification.actuator.where import Group, where_of
from ema_identification.identification import Candidate, Finding


def candidates_of(
    evidence: Evidence, fits: Sequence[Fit], null_cost: float, reason: str
) -> tuple[Candidate, ...]:
    """Return fits as candidates, one an effect, best first."""
    scale, size = evidence.blocks[0].library.scale, evidence.size
    found: list[Candidate] = []
    for fit in fits:
        name = fit.terms[-1].variant.effect
        if any(c.effect == name for c in found):
            continue
        gain = (null_cost - fit.cost) / max(fit.cost / size, 1e-9)
        found.append(Candidate(
            effect=name, score=float(np.sqrt(fit.cost / size)), p_value=scale.p_gain(gain),
            reason=f"{reason}: as {fit.terms[-1].variant.name}, cost {fit.cost / size:.2f} a "
                   f"feature"))
    return tuple(found)


def findings_of(
    evidence: Evidence, answer: Answer, groups: Sequence[Group], before: Gap, after: Gap,
    null_cost: float,
) -> tuple[Finding, ...]:
    """Return the findings, in the order found."""
    if answer.fit is None:
        return ()
    found = []
    for k, term in enumerate(answer.fit.terms):
        name = term.variant.effect
        equal = []
        for fit in answer.equivalent[k]:
            others = {t.variant.effect for t in fit.terms}
            others -= {t.variant.effect for t in answer.fit.terms}
            equal += sorted(others)
        found.append(Finding(
            effect=name, equivalent=tuple(dict.fromkeys(equal))[:2],
            parameters=parameters_of(answer.fit, k, evidence.usual), where=where_of(groups),
            p_value=answer.p_value[k], gap_before=before.value, gap_after=after.value,
            candidates=candidates_of(evidence, answer.fits, null_cost, "fitted"),
        ))
    return tuple(found)
