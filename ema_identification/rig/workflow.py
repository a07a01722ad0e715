"""`identify_rig`: align, recalibrate, where, name, add, show, prune, for any single axis."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from ema_identification.result import (
    Candidate,
    Formula,
    Identification,
    NamedEffect,
    Parameter,
    Shape,
)
from ema_identification.rig.fit.balance import Design, InputBalance, rms
from ema_identification.rig.fit.estimates import parameters, without_modifiers
from ema_identification.rig.fit.known import known_balance
from ema_identification.rig.fit.model import RigModel, load_rig_model
from ema_identification.rig.fit.regression import Blocks, fit, held_out, make_blocks
from ema_identification.rig.fit.sign_flips import LEVEL_OF_CHANCE
from ema_identification.rig.fit.visible import Check, what_shows
from ema_identification.rig.laws import LAWS
from ema_identification.rig.prepare import prepare
from ema_identification.rig.report.panels import all_panels, unknown_panel
from ema_identification.rig.report.steps import Story, all_steps, updated_text
from ema_identification.rig.report.words import (
    for_unknown,
    next_test,
    shape_words,
    signal_name,
    where,
)
from ema_identification.rig.search.alternatives import (
    LawChoice,
    Trial,
    skew_words,
    standard_error,
    without_skew,
)
from ema_identification.rig.search.remainder import portrait
from ema_identification.rig.search.search import Search, search
from ema_identification.rig.search.shapes import freest_columns, smooth_shapes, waves_in_position
from ema_identification.rig.verdict import outcome, reasons_of, unexplained
from ema_record.errors import unknown_name
from ema_rig.record import RigRecord

Progress = Callable[[str, float], None]
"""Called with what is being done and how much of all is (0 to 1)."""
MAX_RIVALS = 8
QUANTILE = 1.645
"""Standard errors of the noise floor that make its 95 % bound."""
HIDEABLE = (*LAWS, "inertia_change")


def check_rig(measured: Sequence[RigRecord], model: str | Path | None) -> Check:
    """Return what records can show, before anything is fitted; raises as `identify_rig`."""
    return what_shows(prepare(measured, load_rig_model(model).settings))


@threadpool_limits.wrap(limits=1)  # threads of small products only wait for each other
def identify_rig(
    measured: Sequence[RigRecord], model: str | Path | RigModel | None = None, *,
    validate: Sequence[RigRecord] = (), without: Collection[str] = (),
    progress: Progress | None = None,
) -> Identification:
    """Find what the model of a single-axis rig lacks, name it and show the gap shrink.

    Parameters
    ----------
    measured : records of one axis.
    model : what is believed so far; default inertia and viscous friction, both free.
    validate : records of the same axis, of another motion, on which the gap is measured; without
        them it is measured on held-out blocks of `measured`.
    without : collection of str
        Laws that may not be used.
    progress : called with a line and the share that is done.

    Returns
    -------
    Identification
        Its gaps are the rms of the held-out residual, in the unit of the input.

    Raises
    ------
    UsageError, InvalidRecordError, IncompleteRecordError
        Wrong model file or name; records that cannot be used, with the remedy.
    """
    say: Progress = progress or (lambda _what, _share: None)
    for name in without:
        if name not in HIDEABLE:
            raise unknown_name("effect", name, HIDEABLE, "known are " + ", ".join(HIDEABLE))
    given = model if isinstance(model, RigModel) else load_rig_model(model)
    say("aligning", 0.02)
    trajectory = prepare(measured, given.settings)
    design = Design(trajectory)
    start, notes = known_balance(given, design)
    say("looking where they disagree", 0.08)
    smooth = smooth_shapes(trajectory)
    freest = freest_columns(start.columns, smooth)
    blocks = make_blocks(trajectory, fit(freest, trajectory.target).residual)
    start = without_skew(start, blocks)
    same = given.settings.model_copy(
        update={"band": trajectory.band, "standstill": trajectory.standstill})
    held = tuple(Design(prepare([record], same)) for record in validate)
    shapes = [*smooth, *waves_in_position(design)]
    before = tuple(portrait(start, blocks, shapes))
    share = [0.2]

    def report(line: str) -> None:
        share[0] += 0.5 * (0.9 - share[0]) * 0.3
        say(line, share[0])

    found = search(start, blocks, shapes, set(without), report)
    say("measuring the gap", 0.93)
    gaps = [rms(np.concatenate([balance.residual_on(d) for d in held]) if held
                else balance.held_out(blocks)) for balance in found.stages]
    floor, bound = _noise_floor(found, blocks, held)
    findings = _findings(found, blocks, gaps)
    targets = [d.trajectory.target for d in held] or [trajectory.target]
    story = Story(trajectory=trajectory, blocks=blocks, start=start, found=found, gaps=gaps,
                  size=rms(np.concatenate([target - target.mean() for target in targets])),
                  check=what_shows(trajectory),
                  noise_floor=floor, noise_bound=bound, before=before,
                  notes=(*trajectory.notes, *skew_words(found.balance), *notes),
                  findings=findings, validated=len(validate))
    say("done", 1.0)
    return _identification(given, story)


def _noise_floor(found: Search, blocks: Blocks, held: Sequence[Design]) -> tuple[float, float]:
    """Return what the freest model leaves, and its 95 % bound by how much blocks differ.

    The freest model has the terms of the model and every smooth shape. It is fitted for itself and
    named nothing; with records held out it is fitted to those, which decided nothing at all. What
    it leaves of the rows that it was fitted to is less than the noise, and of blocks predicted
    from the others more, by as much to first order in the number of its columns: the floor is the
    rms of both together. The gap may lie on either side of it.
    """
    end = found.balance
    if held:
        parts = [_left_on(design, end) for design in held]
    else:
        shapes = [*smooth_shapes(end.design.trajectory),
                  *(left.shape for left in found.left if left.significant)]
        parts = [_left(freest_columns(end.free_columns, shapes), end.target, blocks)]
    squares, rows = np.concatenate([p for p, _ in parts]), sum(n for _, n in parts)
    total = float(squares.sum())
    return (math.sqrt(total / rows),
            math.sqrt((total + QUANTILE * standard_error(squares)) / rows))


def _left_on(design: Design, end: InputBalance) -> tuple[np.ndarray, int]:
    """Return what the freest model leaves of another record, as `_left`."""
    there = design.led(end.design.lead)
    target = there.trajectory.target
    columns = freest_columns(there.matrix(end.terms, end.fit.coefficients),
                             smooth_shapes(there.trajectory))
    return _left(columns, target, make_blocks(there.trajectory, fit(columns, target).residual))


def _left(columns: np.ndarray, target: np.ndarray, blocks: Blocks) -> tuple[np.ndarray, int]:
    """Return the sums of squares that a fit leaves, shape (blocks,), and the number of rows.

    The mean of those of its own rows and of blocks predicted from the others.
    """
    own, others = fit(columns, target).residual, held_out(columns, target, blocks)
    return blocks.sums(0.5 * (own**2 + others**2)), len(target)


def _findings(found: Search, blocks: Blocks, gaps: list[float]) -> tuple[NamedEffect, ...]:
    first = len(found.stages[0].terms)
    findings = []
    for index, choice in enumerate(found.choices):
        law = choice.trial.term.law
        plain, at = without_modifiers(found.balance, first + index)
        own = parameters(plain, at, blocks)
        rivals = [p for trial in choice.trials  # each in the place of the chosen one
                  if trial.name in choice.equivalent and trial.companion is None
                  for p in parameters(found.stages[index].joined(trial.term), first + index,
                                      blocks)]
        findings.append(NamedEffect(
            effect=choice.trial.name, equivalent=choice.equivalent,
            formula=Formula(law.meaning, law.equation, law.reference),
            parameters=(*own, *rivals), where=where(plain, at, own),
            p_value=choice.trial.p_value, gap_before=gaps[index], gap_after=gaps[index + 1],
            candidates=tuple(_candidate(trial, choice) for trial in choice.trials)))
    return tuple(findings)


def _candidate(trial: Trial, choice: LawChoice | None = None) -> Candidate:
    if choice is not None and trial.name == choice.trial.name:
        reason = "taken"
    elif choice is not None and trial.name in choice.equivalent:
        reason = "cannot be told from the one taken"
    elif trial.p_value > LEVEL_OF_CHANCE:
        reason = "no more than chance"
    else:
        reason = "helps less"
    return Candidate(effect=trial.name, score=trial.score, p_value=trial.p_value, reason=reason)


def _identification(given: RigModel, story: Story) -> Identification:
    found, trajectory = story.found, story.trajectory
    unknown, panels = None, all_panels(found.stages[0], found.balance)
    if found.unknown is not None:
        panels = (*panels, unknown_panel(found.unknown, trajectory))
        unknown = Shape(port=signal_name(trajectory), text=shape_words(found.unknown, trajectory),
                        panel=panels[-1])
    verdict, said = outcome(story)
    ambiguous = next((f for f in story.findings if f.equivalent), None)
    test = None
    if ambiguous is not None:
        test = next_test((ambiguous.effect, *ambiguous.equivalent), trajectory)
    elif found.unknown is not None:
        test = for_unknown(found.unknown.shape.against, trajectory)
    held = f"record{'s' if story.validated > 1 else ''} held out" if story.validated else \
        f"{story.blocks.count} blocks, each predicted from the others; they also chose the laws"
    return Identification(
        verdict=verdict, gap_before=story.gaps[0], gap_after=story.gaps[-1],
        noise_floor=story.noise_floor, held_out=bool(story.validated), machine="rig",
        gap_unit=f"residual of the {signal_name(trajectory)}, rms, "
                 f"{trajectory.axis.input_channel.unit} ({held})",
        findings=story.findings,
        rivals=tuple(_candidate(t) for t in found.last_trials[:MAX_RIVALS]),
        next_test=test, recalibrated=_recalibrated(story), unknown=unknown,
        reasons=(*said, *reasons_of(story)), unexplained=unexplained(story),
        steps=all_steps(story), panels=panels,
        model_text="" if verdict == "contradicted" else updated_text(given, story),
    )


def _recalibrated(story: Story) -> tuple[Parameter, ...]:
    """Return the parameters of the model's own terms, in the model at the end."""
    balance = story.found.balance
    return tuple(p for index in range(len(story.start.terms)) if not balance.replaced(index)
                 for p in parameters(balance, index, story.blocks))
