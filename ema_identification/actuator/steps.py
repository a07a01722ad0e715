"""What each step did, in words and tables, for somebody who was not there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.answer import Answer
from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.law_check import Law
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.spread import TOLERANCES
from ema_identification.actuator.where import Group, where_step
from ema_identification.identification import Identification, Step


def steps_of(
    evidence: Evidence, null: Recalibration, answer: Answer, law: Law | None,
    groups: Sequence[Group], found: Identification, how: str,
) -> tuple[Step, ...]:
    """Return the steps in order."""
    steps = [_align(evidence), _recalibrate(evidence, null), where_step(groups),
             _name(evidence, answer, law)]
    if answer.fit is not None:
        steps.append(_add(found))
    steps.append(Step(
        name="show", text=f"Gap on data that took no part in the fit ({how}): "
        f"{found.gap_before:.2f} before, {found.gap_after:.2f} after; {found.noise_floor:.2f} "
        "is the floor."))
    if answer.fit is not None and len(answer.fit.terms) > 1:
        steps.append(Step(
            name="prune", text="Each effect was kept because the misfit is clearly larger "
            "without it."))
    return tuple(steps)


def _align(evidence: Evidence) -> Step:
    rows = [("record", "winding (degC)", "bus (relative)", "noise factor", "rotor angle (rad)")]
    for block in evidence.blocks:
        c = block.conditions
        rows.append((
            block.record.profile.name,
            f"{c.temperature:.1f}" if "temperature" in c.measured else "not measured",
            f"{c.bus:+.3f}" if "bus" in c.measured else "not measured",
            f"{c.noise:.2f}", f"{c.start_angle:.2f}"))
    return Step(name="align", rows=tuple(rows), text=(
        "The simulator starts at the measured rotor angle, with the measured winding temperature, "
        "bus voltage and noise. The noise floor is what runs of one unit differ by when only the "
        "noise differs."))


def _recalibrate(evidence: Evidence, null: Recalibration) -> Step:
    z = evidence.tolerances.of(0, null.z)
    deviation = evidence.tolerances.of(0, np.sqrt(np.diag(null.covariance)))
    rows = [("parameter", "moved by", "its tolerance", "uncertain by")]
    for t, x, s in zip(TOLERANCES, z, deviation):
        unit = "" if t.unit == "1" else f" {t.unit}"
        rows.append((t.name, f"{t.half_width * x:+.4g}{unit}", f"±{t.half_width:g}{unit}",
                     f"{t.half_width * s:.2g}{unit}"))
    return Step(name="recalibrate", rows=tuple(rows), text=(
        "Known parameters moved within their tolerances; misfit "
        f"{null.cost / evidence.size:.2f} a feature is left (about "
        f"{np.exp(evidence.blocks[0].library.scale.fit[0]):.2f} when nothing is missing)."))


def _name(evidence: Evidence, answer: Answer, law: Law | None) -> Step:
    rows = [("candidate", "coordinates", "misfit a feature")]
    for fit in answer.fits:
        term = fit.terms[-1]
        rows.append((term.variant.name, ", ".join(f"{x:.4g}" for x in term.u),
                     f"{fit.cost / evidence.size:.2f}"))
    if answer.fit is not None and len(answer.fit.terms) > 1:
        rows.append((" and ".join(t.variant.name for t in answer.fit.terms),
                     "; ".join(", ".join(f"{x:.4g}" for x in t.u) for t in answer.fit.terms),
                     f"{answer.fit.cost / evidence.size:.2f}"))
    text = (f"Best gain of a single effect {answer.gain:.0f}; "
            + ("nothing is named. " if not answer.fits else
               f"{len(answer.fits)} candidates were fitted with the simulator. ")
            + " ".join(answer.reasons))
    if law is not None and law.holds:
        text += f" By itself the control law holds: {law.text}; no effect of the controller."
    return Step(name="name", text=text.strip(), rows=tuple(rows) if answer.fits else ())


def _add(found: Identification) -> Step:
    rows = [("parameter", "value", "90 % interval")]
    for finding in found.findings:
        rows += [(p.name, f"{p.value:.4g} {'' if p.unit == '1' else p.unit}".strip(),
                  f"{p.low:.4g} to {p.high:.4g}") for p in finding.parameters]
    return Step(name="add", rows=tuple(rows),
                text="Added to the model file, with the recalibrated parameters of the hardware.")
