"""Decide within what the control law, measured by itself, leaves open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ema_identification.actuator.answer import Answer
from ema_identification.actuator.decision import decide
from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.law_check import Law, check_law
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.runs import Progress, silent


def decide_lawfully(
    evidence: Evidence, null: Recalibration, *, without: Sequence[str] = (),
    progress: Progress = silent, seed: int = 0,
) -> tuple[Answer, Law | None]:
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
