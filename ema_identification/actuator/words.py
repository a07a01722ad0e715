"""What was found, in words: where it lives, the findings of the result, and the steps taken."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.decision.answer import FleetAnswer, log_evidence, order_of
from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.intervals import posterior_of
from ema_identification.actuator.decision.proposals import gain_of
from ema_identification.actuator.decision.ranks import rank
from ema_identification.actuator.fleet.units import deviations, half_widths
from ema_identification.actuator.laws.terms import LawFit, LawGap, Posterior, choices_of
from ema_identification.actuator.measure.control_law import ControlLaw
from ema_identification.actuator.measure.tolerances import TOLERANCES
from ema_identification.actuator.residuals import (
    SHOWN,
    ResidualGroup,
    groups_of,
    residual_of,
    where_of,
    where_step,
)
from ema_identification.result import (
    Candidate,
    Formula,
    Identification,
    NamedEffect,
    Parameter,
    Step,
)
from ema_sim.effects import EFFECTS
from ema_sim.effects.base import Quantity

QUANTILE = 1.645
"""Of the normal distribution, for an interval of 90 %."""
DRAWS = 400


def candidates_of(unit: TestedUnit, answer: FleetAnswer) -> tuple[Candidate, ...]:
    """Return the fits of single effects that were not named, one an effect, best first."""
    named = set() if answer.fit is None else {*answer.fit.names, *sum(answer.equivalent, ())}
    found: dict[str, Candidate] = {}
    for fit in answer.fits:
        if len(fit.terms) == 1 and fit.names[0] not in named and np.isfinite(fit.cost):
            gain = gain_of(answer.null.cost, fit.cost, unit.size)
            found.setdefault(fit.names[0], Candidate(
                effect=fit.names[0], score=float(np.sqrt(fit.cost / unit.size)),
                p_value=rank(gain, unit.library.healthy[:, 1]),
                reason=f"fitted: as {fit.terms[0].variant.name}, cost "
                       f"{fit.cost / unit.size:.2f} a feature"))
    return tuple(found.values())


def parameters_of(
    unit: TestedUnit, fit: LawFit, known: Posterior, index: int
) -> tuple[Parameter, ...]:
    """Return the parameters of a law with intervals of 90 %, by draws of its coordinates."""
    begin = sum(t.variant.size for t in fit.terms[:index])
    term = fit.terms[index]
    part = slice(begin, begin + term.variant.size)
    draws = np.random.default_rng(0).multivariate_normal(
        known.mean[part], known.covariance[part, part], size=DRAWS)
    draws = np.clip(draws, term.variant.low, term.variant.high)
    kinds = {f.name: f.kind for f in EFFECTS[term.variant.effect].fields}
    found = []
    for name, value in term.variant.settings(term.u).items():
        kind, middle = kinds[name], float(value)
        if not isinstance(kind, Quantity):
            continue
        values = np.array([float(term.variant.settings(u)[name]) for u in draws])
        if kind.unit == "rad" and name in ("phase", "angle"):
            values = middle + np.angle(np.exp(1j * (values - middle)))
        low, high = (float(x) for x in np.quantile(values, (0.05, 0.95)))
        whole = f"{term.variant.effect}.{name}"
        ends = [low, middle, high, *_shared_with_the_day(unit, fit, whole, middle)]
        found.append(Parameter(name=whole, value=middle, low=min(ends), high=max(ends),
                               unit=kind.unit))
    return tuple(found)


def _shared_with_the_day(
    unit: TestedUnit, fit: LawFit, name: str, value: float
) -> tuple[float, ...]:
    """Return the ends of what a law may be that adds to a number of the day.

    A test tells their sum; the day's is anything in its band (nine tenths of it, for 90 %), so
    that only tests of several days tell them apart.
    """
    names = [t.name for t in TOLERANCES]
    if name not in names:
        return ()
    place = names.index(name)
    half = float(half_widths(unit.library.spread)[place])
    sums = [value + half * float(fit.z[places[place]]) for places in unit.places]
    low, high = max(sums) - 0.9 * half, min(sums) + 0.9 * half
    return (low, high) if low < high else ()


def findings_of(unit: TestedUnit, answer: FleetAnswer, gap: LawGap) -> tuple[NamedEffect, ...]:
    """Return the findings, the one that alone explains more first.

    Each has its own gaps, p-value and place: where the model without it, but with the other one
    of two, disagrees.
    """
    if answer.fit is None or answer.known is None:
        return ()
    found: list[NamedEffect] = []
    for k in order_of(answer):
        term = answer.fit.terms[k]
        effect, at = EFFECTS[term.variant.effect], min(len(found), len(gap.values) - 2)
        less = answer.alone[1 - k] if answer.alone else answer.null
        found.append(NamedEffect(
            effect=term.variant.effect, equivalent=answer.equivalent[k],
            choices=choices_of(term),
            formula=Formula(effect.summary, effect.equation, effect.reference),
            parameters=parameters_of(unit, answer.fit, answer.known, k),
            where=where_of(groups_of(unit, residual_of(unit, less))),
            p_value=answer.p_value[k], gap_before=gap.values[at], gap_after=gap.values[at + 1]))
    return tuple(found)


def reasons_of(answer: FleetAnswer, gap: LawGap) -> tuple[str, ...]:
    """Return why, what each law closes, and of a silence that it is not sure."""
    names = () if answer.fit is None else answer.fit.names
    shares = (f"{name} closes {share:.0%} of what the model leaves"
              for name, share in zip(names, answer.closed))
    doubt = (f"yet the gap of {gap.values[0]:.3g} is beyond the {gap.bound:.3g} of 95 % of "
             "healthy units: repeat the test, or give a record from its acceptance (--baseline)",)
    unsure = answer.verdict == "no disagreement" and gap.values[0] > gap.bound
    return (*answer.reasons, *shares, *(doubt if unsure else ()))


def recalibrated_of(
    unit: TestedUnit, fit: LawFit, known: Posterior | None = None
) -> tuple[Parameter, ...]:
    """Return in what the unit differs from the model, relative or in its unit; intervals of 90 %.

    What belongs to the day is that of the first record.
    """
    known = posterior_of(unit, fit) if known is None else known
    mean, spread = known.mean[fit.free:], np.sqrt(np.diag(known.covariance))[fit.free:]
    low_z, high_z = mean - QUANTILE * spread, mean + QUANTILE * spread
    edge = np.maximum(1.0, np.abs(fit.z))  # of its band, or where it was fitted beyond
    low, value, high = (
        deviations(unit.library.model.actuator, unit.library.spread, np.clip(z, -edge, edge))
        for z in (np.minimum(low_z, fit.z), fit.z, np.maximum(high_z, fit.z)))
    return tuple(Parameter(name=name, value=x, low=low[name][0], high=high[name][0], unit=of)
                 for name, (x, of) in value.items())


def steps_of(
    unit: TestedUnit, answer: FleetAnswer, law: ControlLaw | None,
    groups: Sequence[ResidualGroup], found: Identification, gap: LawGap,
) -> tuple[Step, ...]:
    """Return the steps in order."""
    steps = [_align(unit), _recalibrate(unit, answer), where_step(groups),
             _name(unit, answer, law)]
    if answer.fit is not None:
        steps.append(_add(found))
    where = ("held-out records, which took no part in the fit" if found.held_out else
             "the fitted records themselves, since no held-out record was given")
    steps.append(Step(name="show", text=f"Gap on {where}: " + ", ".join(
        f"{value:.2f} {'before' if k == 0 else f'after effect {k}'}"
        for k, value in enumerate(gap.values))
        + f". Half of the healthy units leave {gap.floor:.2f} or less, 95 % of them up to "
          f"{gap.bound:.2f}."))
    return tuple(steps)


def _align(unit: TestedUnit) -> Step:
    rows: list[tuple[str, ...]] = [
        ("record", "winding (degC)", "bus (relative)", "speed noise (times)",
         "current noise (times)", "rotor angle (rad)")]
    for part in unit.parts:
        c = part.conditions
        rows.append((
            part.library.fmap.profile.name,
            f"{c.temperature:.1f}" if "temperature" in c.measured else "not measured",
            f"{c.bus:+.3f}" if "bus" in c.measured else "not measured",
            *(f"{factor:.2f}" for factor in c.noise), f"{c.start_angle:.2f}"))
    return Step(name="align", rows=tuple(rows), text=(
        "The simulator starts at the measured rotor angle, with the measured winding temperature, "
        "bus voltage and noise."))


def _recalibrate(unit: TestedUnit, answer: FleetAnswer) -> Step:
    rows = [("parameter", "differs from the model by", "90 % interval")]
    for p in recalibrated_of(unit, answer.null):
        of = "" if p.unit == "1" else f" {p.unit}"
        rows.append((p.name, f"{p.value:+.3g}{of}", f"{p.low:+.3g} to {p.high:+.3g}"))
    return Step(name="recalibrate", rows=tuple(rows), text=(
        "All that healthy units and days differ in, fitted within its band; misfit "
        f"{answer.null.cost / unit.size:.2f} a feature is left "
        f"({float(np.median(unit.library.healthy[:, 0])):.2f} of half of the healthy units)."))


def _name(unit: TestedUnit, answer: FleetAnswer, law: ControlLaw | None) -> Step:
    rows = [("candidate", "coordinates", "misfit a feature", "log evidence")]
    best = max((log_evidence(f, unit.library) for f in answer.fits), default=0.0)
    for fit in answer.fits[:SHOWN]:
        rows.append((", ".join(t.variant.name for t in fit.terms),
                     "; ".join(", ".join(f"{x:.4g}" for x in t.u) for t in fit.terms),
                     f"{fit.cost / unit.size:.2f}",
                     f"{log_evidence(fit, unit.library) - best:+.1f}"))
    text = (f"Of healthy units, up to {answer.p_nothing:.2g} are as far off; "
            + ("nothing is named. " if not answer.fits else
               f"{len(answer.fits)} models were fitted with the simulator. ")
            + " ".join(answer.reasons))
    if law is not None:
        text += (f" By itself the control law {'holds' if law.holds else 'is another one'}: "
                 f"{law.text}.")
    return Step(name="name", text=text.strip(), rows=tuple(rows) if answer.fits else ())


def _add(found: Identification) -> Step:
    rows = [("parameter", "value", "90 % interval")]
    for finding in found.findings:
        rows += [(name, value, "") for name, value in finding.choices.items()]
        rows += [(p.name, f"{p.value:.4g} {'' if p.unit == '1' else p.unit}".strip(),
                  f"{p.low:.4g} to {p.high:.4g}") for p in finding.parameters]
    return Step(name="add", rows=tuple(rows),
                text="Added to the model file, with the recalibrated parameters of the hardware.")
