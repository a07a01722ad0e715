"""The workflow for our actuator: align, recalibrate, where, name, add, show, prune."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.actuator.alignment import align
from ema_identification.actuator.evidence import Block, Evidence, evidence
from ema_identification.actuator.held_out import Gap, gap_of
from ema_identification.actuator.library import library
from ema_identification.actuator.model_file import model_text
from ema_identification.actuator.naming import (
    LEVEL,
    Scale,
    fit_candidates,
    gain_of,
    propose,
)
from ema_identification.actuator.parameters import parameters_of, recalibrated_of
from ema_identification.actuator.recalibration import Recalibration, recalibrate
from ema_identification.actuator.refit import Fit
from ema_identification.actuator.runs import Progress, silent
from ema_identification.actuator.where import unknown_shape, where_of
from ema_identification.identification import Candidate, Finding, Identification, Step
from ema_record.record import Record
from ema_sim.actuator import Model

GAP_UNIT = "rms of the held-out features, in standard deviations of a repeat"
SET_MARGIN = 12.0
"""Candidates whose cost is this near to the best one's, a unit cost, cannot be told from it."""
SET_SHARE = 0.15
"""The same, of the best cost."""
GOOD_FIT = 1e-3
"""A complete model fits worse than this only so often."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _State:
    evidence: Evidence
    held: Evidence | None
    null: Recalibration
    scale: Scale
    seed: int


def _blocks(
    records: Sequence[Record], model: Model, *, signatures: bool, seed: int, workers: int,
    progress: Progress,
) -> list[Block]:
    found = []
    for record in records:
        known = library(model, record.profile, signatures=signatures, seed=seed, workers=workers,
                        progress=progress)
        found.append(Block(record=record, library=known, conditions=align(record, model),
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
    workers : processes that build libraries.
    seed : of all simulations.
    """
    blocks = _blocks(measured, model, signatures=True, seed=seed, workers=workers,
                     progress=progress)
    ev = evidence(blocks)
    held = evidence(_blocks(validate, model, signatures=False, seed=seed, workers=workers,
                            progress=progress)) if validate else None
    progress("recalibrate", 0.0)
    null = recalibrate(ev, seed=seed)
    state = _State(evidence=ev, held=held, null=null, scale=Scale(), seed=seed)
    progress("where", 0.2)
    local, near, chosen = propose(ev, null, without=without)
    gain = gain_of(local, near[0], ev.size)
    p_gain, p_fit = state.scale.p_gain(gain), state.scale.p_fit(null.cost / ev.size)
    before = gap_of(ev, held, null.z, null.centre, null.mean, None, seed=seed)
    steps = [Step(name="recalibrate", text=f"cost {null.cost:.0f} over {ev.size} features")]
    recalibrated = recalibrated_of(null, ev)
    if p_gain > LEVEL and p_fit > GOOD_FIT:
        return Identification(
            verdict="no disagreement", gap_before=before.value, gap_after=before.value,
            noise_floor=before.floor, gap_unit=GAP_UNIT, steps=tuple(steps),
            recalibrated=recalibrated, model_text=model_text(model, null.z, model.effects),
            reasons=(f"the best effect of the catalogue would lower the misfit by {gain:.1f}, "
                     f"which effect-free records do in {100 * p_gain:.0f} % of cases",),
        )
    progress("name", 0.3)
    fits = fit_candidates(ev, chosen, null, seed=seed)
    best = fits[0]
    after = gap_of(ev, held, best.z, best.z, best.mean, best.effects(model.effects), seed=seed)
    good = state.scale.p_fit(best.cost / ev.size) > GOOD_FIT
    if not good and best.cost > 0.1 * null.cost:
        return Identification(
            verdict="unknown effect", gap_before=before.value, gap_after=before.value,
            noise_floor=before.floor, gap_unit=GAP_UNIT, steps=tuple(steps),
            recalibrated=recalibrated, unknown=unknown_shape(ev, null),
            rivals=_candidates(fits, ev), model_text=model_text(model, null.z, model.effects),
            reasons=("no effect of the catalogue explains the residual",),
        )
    finding = _finding(ev, null, fits, before, after, p_gain)
    return Identification(
        verdict="explained" if good else "partly explained", gap_before=before.value,
        gap_after=after.value, noise_floor=after.floor, gap_unit=GAP_UNIT, findings=(finding,),
        rivals=_candidates(fits[1:], ev), steps=tuple(steps), recalibrated=recalibrated,
        model_text=model_text(model, best.z, best.effects(model.effects)),
    )


def _candidates(fits: Sequence[Fit], ev: Evidence) -> tuple[Candidate, ...]:
    return tuple(
        Candidate(effect=f.terms[-1].variant.effect, score=float(np.sqrt(f.cost / ev.size)),
                  p_value=float("nan"), reason=f.terms[-1].variant.name)
        for f in fits if np.isfinite(f.cost)
    )


def _finding(
    ev: Evidence, null: Recalibration, fits: Sequence[Fit], before: Gap, after: Gap, p: float
) -> Finding:
    best = fits[0]
    margin = SET_MARGIN * best.cost / ev.size + SET_SHARE * best.cost
    name = best.terms[0].variant.effect
    equal: list[str] = []
    for fit in fits[1:]:
        other = fit.terms[0].variant.effect
        if fit.cost - best.cost < margin and other != name and other not in equal:
            equal.append(other)
    return Finding(
        effect=name, equivalent=tuple(equal[:2]), parameters=parameters_of(best, 0),
        where=where_of(ev, null), p_value=p, gap_before=before.value, gap_after=after.value,
        candidates=_candidates(fits, ev),
    )
