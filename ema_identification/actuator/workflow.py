"""The workflow for our actuator: records, libraries, decision, and what is said of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import yaml
from threadpoolctl import threadpool_limits

from ema_identification.actuator.checks import check_records
from ema_identification.actuator.decision.answer import FleetAnswer, stages_of
from ema_identification.actuator.decision.decide import decide
from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.joint import joint_unit
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.decision.ranks import LEVEL, rank
from ema_identification.actuator.fleet.surrogate import FleetLibrary
from ema_identification.actuator.fleet.units import FULL, fleet_unit
from ema_identification.actuator.gap import HeldOut, fitted_gap
from ema_identification.actuator.laws.terms import LawFit, with_terms
from ema_identification.actuator.library.acceptance import with_acceptance
from ema_identification.actuator.library.baseline import changed_unit, with_baselines
from ema_identification.actuator.library.build import fleet_library
from ema_identification.actuator.measure.control_law import control_law
from ema_identification.actuator.measure.features import nominal_rate
from ema_identification.actuator.measure.recorder import recorded_alike, whole
from ema_identification.actuator.measure.runs import Progress
from ema_identification.actuator.measure.tolerances import RecordConditions, align
from ema_identification.actuator.next_test import separating_test
from ema_identification.actuator.panels import panels_of, record_of
from ema_identification.actuator.ports import unknown_shape
from ema_identification.actuator.residuals import groups_of, residual_of
from ema_identification.actuator.words import (
    candidates_of,
    findings_of,
    reasons_of,
    recalibrated_of,
    steps_of,
)
from ema_identification.result import Identification
from ema_record.actuator import Actuator, load_actuator
from ema_record.record import Record
from ema_sim.effects import EFFECTS, Effects
from ema_sim.effects.base import Choice, Effect
from ema_sim.model_file import Model

GAP_UNIT = ("rms of the tenth of the features that are off most, in standard deviations of what "
            "the model without an effect may be off when nothing is missing")
HELD_OUT = "held-out records, which took no part in the fit"
NO_TEST = "no test of the kit is likely to tell the names apart that fit equally well"
FITTED = "the fitted records themselves: no held-out record was given"
HEADER = "# Written by ema identify: recalibrated parameters, and the effects that were found.\n"


def identify_actuator(
    measured: Sequence[Record], model: Model, *, validate: Sequence[Record],
    baseline: Sequence[Record], without: Sequence[str], progress: Progress, workers: int,
    seed: int,
) -> Identification:
    """Return what the model lacks to explain records of one actuator.

    Parameters
    ----------
    measured : records of one unit, of one or more profiles.
    model : parameters and effects that the model has.
    validate : held-out records of the same unit.
    baseline : records of the unit from when it was accepted, of the test of the first one
        measured: what has changed since is said too.
    without : effects of the catalogue that are not to be considered.
    progress : called with what is being done and how much of it is.
    workers : processes that build libraries, threads that share the runs.
    seed : of all simulations.
    """
    own = recorded_alike((*measured, *validate, *baseline), model)

    def library_of(record: Record, *, signatures: bool = True) -> FleetLibrary:
        """Return the library of its test; `signatures`: effects may be named by it."""
        return fleet_library(
            own, record.profile, rate=nominal_rate(record), signatures=signatures, sizes=FULL,
            seed=seed, workers=workers, progress=progress)

    def tested(record: Record, *, signatures: bool = True) -> TestedUnit:
        """Return the record as it is judged."""
        library = with_acceptance(library_of(record, signatures=signatures), seed=seed)
        return TestedUnit(library=library, values=library.fmap.extract(record), seed=seed,
                          conditions=align(record, own), workers=workers, record=record)

    given, held_out, accepted = ([whole(record, own.actuator) for record in records]
                                 for records in (measured, validate, baseline))
    check_records(given, held_out, own, without, accepted)
    with threadpool_limits(limits=1):  # sums in one order: the last digit grows in limit cycles
        units = [tested(record) for record in given]
        unit, held = joint_unit(units, scores, progress=progress), None
        if held_out:
            other = [tested(record, signatures=False) for record in held_out]
            held = HeldOut(unit=joint_unit(other), fitted=unit, progress=progress)
        found = _said(unit, decide(unit, held, without=without, progress=progress), model, held)
        if not accepted:
            return found
        before = [tested(record) for record in accepted]
        library, apart = with_baselines(library_of(given[0]), seed=seed, workers=workers,
                                        progress=progress)
        changed = changed_unit(replace(units[0], library=library), before, apart)
        since = decide(changed, witness=held, without=without, progress=progress)
        return replace(found, since=_said(changed, since, model))


def _said(
    unit: TestedUnit, answer: FleetAnswer, model: Model, held: HeldOut | None = None
) -> Identification:
    """Return the answer in words, numbers and pictures."""
    gap = fitted_gap(unit, stages_of(answer)) if answer.gap is None else answer.gap
    residual = residual_of(unit, answer.null)
    groups, first = groups_of(unit, residual), unit.parts[0]
    run = record_of(first, answer.null)
    law = None if run is None or first.record is None else control_law(
        first.record, run, first.library.model.actuator)
    rivals = _rivals(answer)
    proposed = separating_test(unit, rivals) if len(rivals) > 1 else None
    fit = answer.null if answer.fit is None else answer.fit
    left = answer.null if answer.verdict == "contradicted" else fit
    something = answer.verdict in ("unknown effect", "partly explained", "contradicted") and (
        answer.fit is None or rank(left.cost / unit.size, unit.library.healthy[:, 0]) <= LEVEL)
    found = Identification(
        verdict=answer.verdict, gap_before=gap.values[0], gap_after=gap.values[-1],
        noise_floor=gap.floor, held_out=answer.gap is not None,
        gap_unit=f"{GAP_UNIT} ({FITTED if answer.gap is None else HELD_OUT})",
        findings=findings_of(unit, answer, gap), rivals=candidates_of(unit, answer),
        next_test=None if proposed is None else proposed.text,
        next_profile=None if proposed is None else proposed.profile,
        recalibrated=recalibrated_of(unit, fit, answer.known),
        reasons=(*reasons_of(answer, gap), *((NO_TEST,) if len(rivals) > 1 and proposed is None
                                             else ())),
        unknown=unknown_shape(unit, residual_of(unit, left), law) if something else None,
        model_text="" if answer.verdict == "contradicted" else _model_text(unit, fit, model))
    return replace(
        found, steps=steps_of(unit, answer, law, groups, found, gap),
        panels=panels_of(unit, answer, None if held is None else held.unit, gap))


def _rivals(answer: FleetAnswer) -> list[LawFit]:
    """Return the fits that the data cannot tell apart, the one named first."""
    left = set().union(*answer.equivalent)
    own: set[str] = set() if answer.fit is None else set(answer.fit.names)
    found = [] if answer.fit is None else [answer.fit]
    for fit in answer.fits:
        instead = set(fit.names) - own
        if len(fit.terms) == max(len(own), 1) and len(instead) == 1 and instead <= left:
            found.append(fit)
            left -= instead
    return found


def _model_text(unit: TestedUnit, fit: LawFit, model: Model) -> str:
    """Return the model file: the hardware as recalibrated, and the effects."""
    actuator, _ = fleet_unit(  # conditions and sensor errors stay out
        model, unit.library.spread, fit.z[:unit.library.width], RecordConditions(), model.effects)
    return model_file_text(actuator, with_terms(fit.terms, model.effects))


def model_file_text(actuator: Actuator, effects: Effects) -> str:
    """Return the model file: every parameter that differs from nominal, and the effects."""
    nominal = load_actuator()
    data: dict[str, Any] = {}
    for section, part in actuator._asdict().items():
        base = getattr(nominal, section)
        if changed := {name: _number(value) for name, value in part._asdict().items()
                       if value != getattr(base, name)}:
            data[section] = changed
    if added := {name: _settings(EFFECTS[name], values)
                 for name, values in effects._asdict().items()
                 if not EFFECTS[name].is_neutral(values)}:
        data["effects"] = added
    return HEADER + yaml.safe_dump(data, sort_keys=False, allow_unicode=True)


def _settings(effect: Effect, values: Any) -> dict[str, Any]:
    chosen = {f: getattr(values, f.name) for f in effect.fields}
    return {f.name: f.kind.options[int(x)] if isinstance(f.kind, Choice) else _number(x)
            for f, x in chosen.items() if x != f.default or f.name in effect.severity}


def _number(value: float) -> float | int:
    return int(value) if isinstance(value, int) else float(f"{value:.8g}")
