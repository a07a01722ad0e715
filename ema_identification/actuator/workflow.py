"""The workflow for our actuator: align, recalibrate, where, name, add, show, prune."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ema_identification.actuator.checks import check_records
from ema_identification.actuator.measure.features import nominal_rate
from ema_identification.actuator.measure.recorder import recorded_alike, whole
from ema_identification.actuator.measure.runs import Progress, Runner, silent
from ema_identification.actuator.measure.tolerances import align
from ema_identification.actuator.naming.answer import Answer, stages_of
from ema_identification.actuator.naming.contest import Arena
from ema_identification.actuator.naming.decision import decide_lawfully
from ema_identification.actuator.naming.estimates import (
    estimate_again,
    is_entangled,
    model_text,
    recalibrated_of,
)
from ema_identification.actuator.naming.gap import gap_of
from ema_identification.actuator.naming.next_test import separating_test
from ema_identification.actuator.panels import panels_of
from ema_identification.actuator.ports import unknown_shape
from ema_identification.actuator.surrogate.calibration import library
from ema_identification.actuator.surrogate.evidence import Evidence, RecordEvidence, evidence
from ema_identification.actuator.surrogate.likelihood import recalibrate
from ema_identification.actuator.words import candidates_of, findings_of, groups_of, steps_of
from ema_identification.result import Identification, after_validation
from ema_record.record import Record
from ema_sim.effects import Effects
from ema_sim.model_file import Model

GAP_UNIT = ("rms of the tenth of the features that are off most, in standard deviations of what "
            "the model as given may be off when nothing is missing")
HELD_OUT = "held-out records, which took no part in the fit"
FITTED = "the fitted records themselves: no held-out record was given"


def _blocks(
    records: Sequence[Record], model: Model, *, signatures: bool, seed: int, workers: int,
    progress: Progress,
) -> list[RecordEvidence]:
    found = []
    for record in records:
        known = library(model, record.profile, rate=nominal_rate(record), signatures=signatures,
                        seed=seed, workers=workers, progress=progress)
        found.append(RecordEvidence(record=record, library=known, conditions=align(record, model),
                                    values=known.fmap.extract(record)))
    return found


def identify_actuator(
    measured: Sequence[Record], model: Model, *, validate: Sequence[Record] = (),
    without: Sequence[str] = (), progress: Progress = silent, workers: int = 1, seed: int = 0,
) -> Identification:
    """Return what the model lacks to explain records of one actuator.

    Parameters
    ----------
    measured : records of one unit, of one or more profiles.
    model : parameters and effects that the model has.
    validate : held-out records of the same unit.
    without : effects of the catalogue that are not to be considered.
    progress : called with what is being done and how much of it is.
    workers : processes that build libraries, threads that share the runs.
    seed : of all simulations.
    """
    from threadpoolctl import threadpool_limits

    given = model
    model = recorded_alike((*measured, *validate), given)
    measured, validate = ([whole(record, model.actuator) for record in records]
                          for records in (measured, validate))
    check_records(measured, validate, model, without)
    with threadpool_limits(limits=1):  # sums in one order: the last digit grows in limit cycles
        ready = _blocks(measured, model, signatures=True, seed=seed, workers=workers,
                        progress=progress)
        held_blocks = _blocks(validate, model, signatures=False, seed=seed, workers=workers,
                              progress=progress)
        runner = Runner(workers)
        held = evidence(held_blocks, runner) if held_blocks else None
        return _identify(evidence(ready, runner), held, given, tuple(without), progress, seed)


def _identify(
    ev: Evidence, held: Evidence | None, model: Model, without: tuple[str, ...],
    progress: Progress, seed: int,
) -> Identification:
    progress("recalibrate", 0.0)
    null = recalibrate(ev, seed=seed)
    groups = groups_of(ev, null.whitened(ev))
    progress("name", 0.2)
    answer, law = decide_lawfully(ev, null, without=without, progress=progress, seed=seed)
    if answer.fit is not None and is_entangled(answer.fit):
        progress("estimate", 0.9)
        answer = replace(answer, fit=estimate_again(
            ev, Arena(ev, null, seed=seed).last, answer.fit, seed=seed + 60))
    progress("show", 0.93)
    gap = gap_of(ev, held, null, stages_of(answer), seed=seed)
    if gap.held:
        verdict, said = after_validation(
            answer.verdict, gap.values[0], gap.values[-1], gap.bound, "the model's own runs")
        answer = replace(answer, verdict=verdict, reasons=(*said, *answer.reasons))
    how = HELD_OUT if held else FITTED
    fits = [f for f in answer.fits if np.isfinite(f.cost)]
    findings = findings_of(ev, null, answer, gap)
    ambiguous = next((e for e in answer.equivalent if e), ())
    alike = ambiguous if answer.fit is None else (answer.fit, *ambiguous)
    proposed = separating_test(ev, alike, seed=seed) if ambiguous else None
    fit = answer.fit if answer.fit is not None else null
    found = Identification(
        verdict=answer.verdict, gap_before=gap.values[0], gap_after=gap.values[-1],
        noise_floor=gap.floor, gap_unit=f"{GAP_UNIT} ({how})", held_out=held is not None,
        findings=findings,
        rivals=tuple(
            c for c in candidates_of(ev, fits, answer.null_cost, "fitted")
            if c.effect not in {n for f in findings for n in (f.effect, *f.equivalent)}),
        next_test=None if proposed is None else proposed.text,
        next_profile=None if proposed is None else proposed.profile,
        recalibrated=recalibrated_of(fit, ev), reasons=answer.reasons,
        unknown=unknown_shape(ev, null.whitened(ev), fits, answer.null_cost, law)
        if answer.verdict == "unknown effect" else None,
        model_text="" if answer.verdict == "contradicted" else model_text(
            model, ev.tolerances.of(0, fit.z), _effects(answer, model)),
    )
    return replace(
        found, steps=steps_of(ev, null, answer, law, groups, found, gap),
        panels=panels_of(ev, null, answer, held, gap, seed=seed))


def _effects(answer: Answer, model: Model) -> Effects:
    return model.effects if answer.fit is None else answer.fit.effects(model.effects)
