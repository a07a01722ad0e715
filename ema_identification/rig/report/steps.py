"""What each step did, in words and tables, and the model file with what was found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_identification.report.words import number
from ema_identification.result import NamedEffect, Step
from ema_identification.rig.fit.balance import InputBalance, rms
from ema_identification.rig.fit.estimates import parameters
from ema_identification.rig.fit.known import nominal_coefficients, term_of
from ema_identification.rig.fit.model import (
    DEFAULT_TOLERANCE,
    KnownTerm,
    ModelAxis,
    RigModel,
    Settings,
    dump_rig_model,
)
from ema_identification.rig.fit.regression import Blocks, covariance, half_width
from ema_identification.rig.fit.visible import Check
from ema_identification.rig.laws.base import physical
from ema_identification.rig.report.words import shape_words, signal_name, term_words
from ema_identification.rig.search.remainder import Left
from ema_identification.rig.search.search import Search, whiteness
from ema_identification.rig.signals.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True)
class Story:
    """Everything that the steps tell."""

    trajectory: Trajectory
    blocks: Blocks
    start: InputBalance
    found: Search
    gaps: list[float]
    """Held-out gap at the start and after each finding."""
    size: float
    """Input about its mean where the gap is measured, rms."""
    check: Check
    """What the records can show."""
    noise_floor: float
    noise_bound: float
    """95 % bound of the floor."""
    before: tuple[Left, ...]
    notes: tuple[str, ...]
    findings: tuple[NamedEffect, ...]
    validated: int
    """Number of records that were held out."""


def all_steps(story: Story) -> tuple[Step, ...]:
    """Return the steps in their order."""
    return (_align(story), _recalibrate(story), _where(story), _name(story), _add(story),
            _show(story), _prune(story))


def _align(story: Story) -> Step:
    trajectory = story.trajectory
    unit = trajectory.axis.speed_unit
    duration = sum(segment.step * len(segment) for segment in trajectory.segments)
    filtered = "scipy.signal.decimate" if trajectory.decimation else \
        f"a zero-phase low-pass at {number(trajectory.band)} Hz"
    source = "so wide the response stands above its noise" if trajectory.decimation is None else \
        f"factor {trajectory.decimation}, as the model file says"
    text = (f"{duration:.4g} s in {len(trajectory.segments)} stretch(es); input, motion and every "
            f"regressor go through {filtered} ({source}) to {len(trajectory.target)} rows at "
            f"{number(trajectory.row_rate, 4)} 1/s. Below {number(trajectory.standstill)} {unit} "
            f"the axis counts as at rest ({100 * trajectory.rest:.1f} % of the time); rows at "
            "rest are left out, as dry friction takes any value there. "
            f"{story.blocks.count} blocks of {number(story.blocks.length)} s are held out, and "
            "change their sign, together.")
    notes = (f"{note}." for note in (*story.notes, *story.check.lines))
    return Step(name="align", text=" ".join([text, *notes]))


def _recalibrate(story: Story) -> Step:
    start, trajectory = story.start, story.trajectory
    rows: list[tuple[str, ...]] = [("term", "coefficient", "bounds")]
    for index, term in enumerate(start.terms):
        span = start.span(index)
        for k in range(span.start, span.stop):
            low, high = start.bounds.low[k], start.bounds.high[k]
            bounds = "free" if np.isinf(high) else f"{number(low)} to {number(high)}"
            rows.append((term_words(term, trajectory), number(start.fit.coefficients[k], 4),
                         bounds + (", at its bound" if start.fit.active[k] else "")))
    unit = trajectory.axis.input_channel.unit
    return Step(
        name="recalibrate", rows=tuple(rows),
        text=f"The model's own terms, moved within their tolerances, leave "
             f"{number(rms(start.fit.residual))} {unit} rms of the {signal_name(trajectory)}, "
             f"which is {number(rms(trajectory.target))} {unit} rms itself.")


def _where(story: Story) -> Step:
    rows: list[tuple[str, ...]] = [("shape", "against", "share of the residual", "p")]
    rows += [(shape_words(left, story.trajectory), left.shape.against,
              f"{100 * max(left.gain, 0.0):.1f} %", number(left.p_value))
             for left in story.before[:8]]
    return Step(name="where", rows=tuple(rows),
                text="Shapes that any smooth dependence or wave would leave in the residual, with "
                     "the share of its held-out squares that each takes.")


def _name(story: Story) -> Step:
    rows: list[tuple[str, ...]] = [("step", "law", "held-out gap", "p", "")]
    unit = story.trajectory.axis.input_channel.unit
    for index, finding in enumerate(story.findings):
        for candidate in finding.candidates[:5]:
            rows.append((str(index + 1), candidate.effect,
                         f"{number(candidate.score, 4)} {unit}", number(candidate.p_value),
                         candidate.reason))
    for trial in story.found.last_trials[:5]:
        rows.append((str(len(story.findings) + 1), trial.name,
                     f"{number(trial.score, 4)} {unit}", number(trial.p_value), "not taken"))
    return Step(
        name="name", rows=tuple(rows),
        text="Each law of the catalogue is a regressor along the measured motion. Its p-value "
             "comes from sign flips of whole blocks, all candidates of a step together; the "
             "simplest law that takes nearly as much as the best is taken.")


def _add(story: Story) -> Step:
    rows: list[tuple[str, ...]] = [("effect", "parameter", "value", "90 % interval", "unit")]
    for finding in story.findings:
        for p in finding.parameters:
            rows.append((finding.effect, p.name, number(p.value, 4),
                         f"{number(p.low, 4)} to {number(p.high, 4)}", p.unit))
    text = ("Parameters of what was added, fitted together. A level is that without the terms "
            "that modify it (Stribeck and the like); the model file holds all of them together.")
    text = text if story.findings else "Nothing was added."
    return Step(name="add", text=text, rows=tuple(rows))


def _show(story: Story) -> Step:
    unit = story.trajectory.axis.input_channel.unit
    rows: list[tuple[str, ...]] = [("model", f"held-out gap ({unit})", "in sample")]
    size = rms(story.trajectory.target)
    names = ["as given", *(f"+ {finding.effect}" for finding in story.findings)]
    for name, gap, stage in zip(names, story.gaps, story.found.stages):
        rows.append((name, number(gap, 4),
                     f"{number(100 * rms(stage.fit.residual) / size, 4)} % of the input"))
    _, correlation, bound = whiteness(story.found.balance)
    outside = float(np.mean(np.abs(correlation[1:]) > bound))
    where = "on the records held out" if story.validated else "on blocks held out in turn"
    return Step(
        name="show", rows=tuple(rows),
        text=f"Gap {number(story.gaps[0], 4)} {unit} before, {number(story.gaps[-1], 4)} {unit} "
             f"after, {where}; the freest smooth model, fitted for itself, leaves "
             f"{number(story.noise_floor, 4)} "
             f"{unit}. {100 * outside:.0f} % of the autocorrelation of the rest lies outside the "
             "bounds of white noise (5 % would by chance).")


def _prune(story: Story) -> Step:
    dropped = [term_words(term, story.trajectory) for term in story.found.dropped]
    parts = ["Every added law is missed if it is taken out." if not dropped else
             "Taken out again, as nothing misses them: " + ", ".join(dropped) + "."]
    if story.found.given_up:
        parts.append("Given up, as they stood in for a shape that no law holds: "
                     + ", ".join(story.found.given_up) + ".")
    return Step(name="prune", text=" ".join(parts))


MOST = 1.0
"""Largest tolerance that is written."""


def _axis_of(trajectory: Trajectory) -> ModelAxis:
    """Return what axis it is and how far, fast and hard it was driven."""
    low, high = trajectory.travel
    fast = max(np.abs(s.smooth_speed).max() for s in trajectory.segments)
    return ModelAxis(
        motion=trajectory.axis.motion, input=trajectory.axis.input,
        travel=(float(f"{low:.6g}"), float(f"{high:.6g}")),
        largest_speed=float(f"{fast:.6g}"),
        largest_input=float(f"{np.abs(trajectory.target).max():.6g}"))


def updated_text(given: RigModel, story: Story) -> str:
    """Return the YAML of the model with all terms that were found.

    Every term gets its value and a tolerance that holds its interval; terms that were free
    in the model stay free. Beside them stands what was estimated, with its interval.
    """
    balance, blocks = story.found.balance, story.blocks
    trajectory = story.trajectory
    free = {term_of(entry).key for entry in given.terms if nominal_coefficients(entry)[1]}
    variance = covariance(balance.free_columns, balance.fit.residual, blocks)
    place = np.cumsum(~balance.fixed) - 1
    terms = []
    units = []
    for index, term in enumerate(balance.terms):
        span = balance.span(index)
        if balance.replaced(index):
            continue
        estimated = parameters(balance, index, blocks)
        units += [f"{p.name} {p.unit}" for p in estimated if p.unit != "1"]
        estimate = {p.name.split(".")[1]: (p.value, p.low, p.high) for p in estimated}
        if index < len(story.start.terms) and term.key in free:
            terms.append(KnownTerm(effect=term.law.name, estimate=estimate,
                                   parameters=dict(zip(term.law.shape, term.shape))))
            continue
        values = balance.fit.coefficients[span]
        if term.law.name == "control_delay":
            values = values + balance.design.lead
        wide = [half_width(variance[place[k], place[k]], blocks)
                for k in range(span.start, span.stop) if not balance.fixed[k]]
        size = float(np.linalg.norm(values)) or 1.0
        tolerance = min(MOST, max(DEFAULT_TOLERANCE, 1.5 * max(wide, default=0.0) / size))
        terms.append(KnownTerm(effect=term.law.name,
                               parameters=physical(term.law, term.shape, values),
                               tolerance=float(f"{tolerance:.3g}"), estimate=estimate))
    settings = Settings(**{
        **given.settings.model_dump(exclude_none=True),
        **({} if given.settings.decimate else {"band": float(f"{trajectory.band:.6g}")}),
        "standstill": float(f"{trajectory.standstill:.6g}"),
    })
    names = ", ".join(f.effect for f in story.findings) or "nothing"
    return dump_rig_model(
        RigModel(rig=given.rig if given.rig != "rig" else trajectory.axis.name,
                 terms=tuple(terms), settings=settings, axis=_axis_of(trajectory)),
        f"Updated by ema identify: added {names}.\nInput: "
        f"{trajectory.axis.input_channel.label}; {trajectory.axis.motion} axis.\n"
        f"An estimate is a value and its 90 % interval. Units: {', '.join(dict.fromkeys(units))}.")
