"""What was found, in words: where it lives, the findings of the result, and the steps taken."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.measure.tolerances import TOLERANCES
from ema_identification.actuator.naming.answer import Answer, order_of
from ema_identification.actuator.naming.control_law import ControlLaw
from ema_identification.actuator.naming.estimates import choices_of, parameters_of
from ema_identification.actuator.naming.gap import ModelGap
from ema_identification.actuator.surrogate.evidence import Evidence
from ema_identification.actuator.surrogate.fit import Fit
from ema_identification.actuator.surrogate.likelihood import Recalibration
from ema_identification.result import Candidate, Formula, Identification, NamedEffect, Step, Where
from ema_sim.effects import EFFECTS

SHOWN = 8
"""Rows of the table."""


class ResidualGroup(NamedTuple):
    """Residuals of one signal in one part of the test."""

    excess: float
    """Sum of log(1 + r²), less what noise gives."""
    signal: str
    against: str
    place: str
    largest: float
    """Standard deviations."""
    rms: float


def groups_of(evidence: Evidence, residual: Sequence[np.ndarray]) -> list[ResidualGroup]:
    """Return residuals (standard deviations) by signal, abscissa and place, most excess first."""
    found: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    for block, r in zip(evidence.blocks, residual):
        plan = block.library.fmap.plan
        texts = {s.name: s.text for s in plan.segments}
        texts |= {t.name: t.text for t in plan.transitions}
        for feature, x in zip(block.library.fmap.features, r):
            place = texts.get(feature.place, "whole record")
            found[feature.signal, feature.against, place].append(float(x))
    groups = []
    for (signal, against, place), items in found.items():
        values = np.array(items)
        groups.append(ResidualGroup(
            float(np.log1p(values**2).sum() - 0.55 * len(values)), signal, against, place,
            float(np.abs(values).max()), float(np.sqrt(np.mean(values**2)))))
    return sorted(groups, reverse=True)


def where_of(groups: Sequence[ResidualGroup]) -> Where:
    """Return the place of the largest disagreement."""
    g = groups[0]
    return Where(signal=g.signal, against=g.against, text=(
        f"{g.signal} against {g.against}, {g.place}: {g.rms:.1f} standard deviations rms, "
        f"{g.largest:.1f} at most"))


def where_step(groups: Sequence[ResidualGroup]) -> Step:
    """Return the table of the step."""
    rows = [("signal", "against", "part of the test", "rms", "largest")]
    rows += [(g.signal, g.against, g.place, f"{g.rms:.1f}", f"{g.largest:.1f}")
             for g in groups[:SHOWN]]
    return Step(
        name="where", rows=tuple(rows),
        text="Residuals of the recalibrated model by signal and part of the test, in standard "
             "deviations of what it may be off when nothing is missing. The first row is the one "
             "where most of its features disagree; a single huge value, as a limit cycle out of "
             "phase gives, counts by its logarithm only.")


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
    evidence: Evidence, null: Recalibration, answer: Answer, gap: ModelGap
) -> tuple[NamedEffect, ...]:
    """Return the findings, in the order found.

    Each has its own gaps, p-value and place: where the model without it, but with the other one
    of two, disagrees.
    """
    if answer.fit is None:
        return ()
    found: list[NamedEffect] = []
    for k in order_of(answer):
        name = answer.fit.terms[k].variant.effect
        equal = []
        for fit in answer.equivalent[k]:
            others = {t.variant.effect for t in fit.terms}
            others -= {t.variant.effect for t in answer.fit.terms}
            equal += sorted(others)
        other = answer.alone[1 - k] if answer.alone else None
        without = (null if other is None else other).whitened(evidence)
        effect, at = EFFECTS[name], min(len(found), len(gap.values) - 2)
        found.append(NamedEffect(
            effect=name, equivalent=tuple(dict.fromkeys(equal))[:2],
            choices=choices_of(answer.fit.terms[k]),
            formula=Formula(effect.summary, effect.equation, effect.reference),
            parameters=parameters_of(answer.fit, k, evidence.usual),
            where=where_of(groups_of(evidence, without)),
            p_value=answer.p_value[k], gap_before=gap.values[at], gap_after=gap.values[at + 1],
            candidates=candidates_of(evidence, answer.fits, answer.null_cost, "fitted"),
        ))
    return tuple(found)


def steps_of(
    evidence: Evidence, null: Recalibration, answer: Answer, law: ControlLaw | None,
    groups: Sequence[ResidualGroup], found: Identification, gap: ModelGap,
) -> tuple[Step, ...]:
    """Return the steps in order."""
    steps = [_align(evidence), _recalibrate(evidence, null), where_step(groups),
             _name(evidence, answer, law)]
    if answer.fit is not None:
        steps.append(_add(found))
    where = ("held-out records, which took no part in the fit" if gap.held else
             "the fitted records themselves, since no held-out record was given")
    steps.append(Step(
        name="show", text=f"Gap on {where}: "
        + ", ".join(f"{value:.2f} {'before' if k == 0 else f'after effect {k}'}"
                    for k, value in enumerate(gap.values))
        + f". Runs of the last model in the place of the measurement leave {gap.floor:.2f} "
        f"(median of {len(gap.draws)}), and as much as the measurement with probability "
        f"{gap.p_value:.2g}."))
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


def _name(evidence: Evidence, answer: Answer, law: ControlLaw | None) -> Step:
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
        rows += [(name, value, "") for name, value in finding.choices.items()]
        rows += [(p.name, f"{p.value:.4g} {'' if p.unit == '1' else p.unit}".strip(),
                  f"{p.low:.4g} to {p.high:.4g}") for p in finding.parameters]
    return Step(name="add", rows=tuple(rows),
                text="Added to the model file, with the recalibrated parameters of the hardware.")
