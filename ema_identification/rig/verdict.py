"""The verdict on a rig, tied to what is explained, and what there is to say beside it."""

from __future__ import annotations

import numpy as np

from ema_identification.report.words import number
from ema_identification.result import Outcome, after_validation
from ema_identification.rig.fit.estimates import parameters
from ema_identification.rig.fit.known import common_factor
from ema_identification.rig.laws.static import both_directions
from ema_identification.rig.report.steps import Story
from ema_identification.rig.report.words import shape_words, signal_name, term_words
from ema_identification.rig.search.remainder import main_shape

MUCH = 0.1
"""Share of the input that is not explained without a word."""
MOST_UNEXPLAINED = 0.25
"""Largest share of the input (held-out residual over the input about its mean, rms) that is not
explained in a record that is called so."""
UNSURE = 0.5
"""A parameter whose interval is wider, of its value to either side, is hardly shown."""


def unexplained(story: Story) -> float:
    """Return the share of the input that is left: the gap over the input about its mean, rms."""
    return story.gaps[-1] / max(story.size, 1e-300)


def outcome(story: Story) -> tuple[Outcome, tuple[str, ...]]:
    """Return the verdict and why it is no better."""
    verdict: Outcome = "no disagreement"
    if story.findings:
        verdict = "explained" if story.found.unknown is None else "partly explained"
    elif story.found.unknown is not None:
        verdict = "unknown effect"
    said: tuple[str, ...] = ()
    if story.validated:
        verdict, said = after_validation(
            verdict, story.gaps[0], story.gaps[-1], story.noise_bound, "the freest model's fit")
    if verdict == "explained" and story.validated and story.gaps[-1] > story.gaps[0]:
        verdict = "partly explained"
    left = unexplained(story)
    if verdict in ("explained", "no disagreement") and left > MOST_UNEXPLAINED:
        verdict = "partly explained"
        said = (*said, f"{100 * left:.0f} % of the {signal_name(story.trajectory)} is not "
                f"explained, more than {100 * MOST_UNEXPLAINED:.0f} %")
    balance = story.found.balance
    if verdict == "explained" and any(
            term.law.name == "inertia" and not balance.replaced(k)
            and balance.bounds.low[balance.span(k)][0] == 0.0
            and balance.fit.active[balance.span(k)].any()
            for k, term in enumerate(balance.terms[:len(story.start.terms)])):
        return "partly explained", (*said, "no axis is without inertia")
    return verdict, said


def _not_shown(story: Story) -> list[str]:
    """Return the model's own terms that stand at a bound or are hardly shown."""
    balance, lines = story.found.balance, []
    for index, term in enumerate(story.start.terms):
        span = balance.span(index)
        if balance.replaced(index):
            continue
        name = term_words(term, story.trajectory)
        low, high = balance.bounds.low[span], balance.bounds.high[span]
        if balance.fit.active[span].any():
            room = f"{number(float(low[0]))} to {number(float(high[0]))}"
            lines.append(f"{name} is 0, its bound: this record does not show it"
                         if np.isinf(high).any() else
                         f"{name} stands at the bound of its tolerance ({room})")
            continue
        for p in parameters(balance, index, story.blocks):
            if p.high - p.low > 2.0 * UNSURE * abs(p.value):
                lines.append(f"{p.name} is hardly shown by this record: {number(p.value)} {p.unit}"
                             f" (90 %: {number(p.low)} to {number(p.high)})")
    return lines


def reasons_of(story: Story) -> tuple[str, ...]:
    """Return what there is to say of an answer, one line each."""
    reasons = [*story.check.lines, *story.notes, *_not_shown(story)]
    if not both_directions(story.trajectory):
        reasons.append("the axis moves one way only: Coulomb friction and an offset look alike; "
                       "record both directions")
    if story.found.given_up:
        reasons.append("given up, as they only stood in for a shape that no law holds: "
                       + ", ".join(story.found.given_up))
    factor = common_factor(story.start, story.found.balance)
    if factor is not None:
        reasons.append(
            f"all known terms are {factor:.3g} times those of the model: a wrong gain of the "
            f"{signal_name(story.trajectory)} looks the same; calibrate it with a known load")
    reasons += _of_the_rest(story)
    return tuple(reasons)


def _of_the_rest(story: Story) -> list[str]:
    """Return what is said of a remainder that is no unknown effect."""
    if story.found.unknown is not None:
        return []
    trajectory = story.trajectory
    minor = main_shape(story.found.left, 0.0)
    if minor is not None:
        return [f"no further law; a remainder of {100 * minor.share:.1f} % of the "
                f"{signal_name(trajectory)} stays, its cause unknown: "
                f"{shape_words(minor, trajectory)}"]
    share = unexplained(story)
    if share > MUCH:
        return [f"{100 * share:.0f} % of the {signal_name(trajectory)} is not explained, and no "
                "shape of it is more than chance: record longer, or with less noise"]
    return []
