"""The search for what a balance lacks: laws with a name, then shapes without one.

Forward one law at a time, with exchanges; then laws that nothing misses once the others are there
are pruned, and those that only stood in for a nameless shape given up.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from ema_identification.rig.fit.balance import InputBalance
from ema_identification.rig.fit.regression import Blocks, autocorrelation
from ema_identification.rig.laws.base import Term
from ema_identification.rig.search.alternatives import (
    LawChoice,
    Trial,
    best_placed,
    equivalents,
    refined,
    with_whole_delay,
    without_skew,
)
from ema_identification.rig.search.remainder import Left, main_shape, mimics, portrait
from ema_identification.rig.search.selection import Look, choose, least_loss, located, prune
from ema_identification.rig.search.shapes import GenericShape, freest_columns, waves_in_time

MAX_ADDED = 12
MAX_EXCHANGES = 4
MOST_TO_EXCHANGE = 5
"""Laws of a model above which none is exchanged: a look for each of them costs too much."""
CLEARLY_LESS = 0.8
"""Share of the held-out squares below which another law, or another order, explains more ..."""
ALIKE, FEWER = 1.02, 0.67
"""... and below which it explains as much; then it wins with this share of the parameters."""

Way = tuple[list[InputBalance], list[LawChoice], tuple[Trial, ...], list[Term]]
"""Stages, choices, what was tried at the end and not taken, what was pruned."""


def rebuilt(start: InputBalance, choices: list[LawChoice], blocks: Blocks) -> list[InputBalance]:
    """Return the start and the balance after each choice, its input on the clock of the motion."""
    stages = [start]
    for choice in choices:
        joined = with_whole_delay(stages[-1].joined(choice.trial.term))
        stages.append(without_skew(joined, blocks))
    return stages


def forward(start: InputBalance, look: Look) -> Way:
    """Add laws while they help, exchange those that another does better, drop the rest.

    Where a law that filters the motion had to wait for a plain one though it took more, the
    other order is tried too, and taken if it leaves clearly less.
    """
    way, contested = _one_way(start, look)
    if not contested:
        return way
    other, _ = _one_way(start, replace(look, plain_first=False))
    squares = [stages[-1].squares(look.blocks) for stages, *_ in (way, other)]
    sizes = [sum(c.trial.term.law.complexity for c in choices)
             for _, choices, *_ in (way, other)]
    clearly = squares[1] < CLEARLY_LESS * squares[0]
    as_well = squares[1] <= ALIKE * squares[0] and sizes[1] <= FEWER * sizes[0]
    return other if clearly or as_well else way


def _one_way(start: InputBalance, look: Look) -> tuple[Way, bool]:
    """Return what one order of the laws leads to, and whether it was contested."""
    stages = [start]
    choices: list[LawChoice] = []
    trials: tuple[Trial, ...] = ()
    contested = False
    exchanges = 0
    while len(choices) < MAX_ADDED:
        choice, trials = choose(stages[-1], look)
        if choice is None:
            better = _exchanged(start, choices, stages, look) \
                if exchanges < MAX_EXCHANGES else None
            if better is None:
                break
            exchanges += 1
            choices, stages = better
            continue
        contested = contested or choice.contested
        for one in _one_by_one(choice):
            look.report(f"found {one.trial.name}")
            choices.append(one)
        choices, stages = _polished(start, choices, look.blocks)
    choices, stages, dropped = pruned(start, choices, look.blocks)
    choices, stages, more = _simplified(start, choices, stages, look)
    choices, stages, others = _one_for_two(start, choices, stages, look)
    dropped += [*more, *others]
    end, first = stages[-1], len(start.terms)
    if lost := frozenset(  # filter the motion or follow it and, beside the others, need not be
            term.law.name for index, term in enumerate(end.terms)
            if index >= first and (term.law.dynamic or term.law.beside)
            and not located(end, look.blocks, index)):
        return _one_way(start, replace(look, hidden=look.hidden | lost))
    return (stages, choices, trials, dropped), contested


def _simplified(
    start: InputBalance, choices: list[LawChoice], stages: list[InputBalance], look: Look
) -> tuple[list[LawChoice], list[InputBalance], list[Term]]:
    """Return the choices without those that another one does for, once it is in its own place.

    What was named first may have stood in for what came later, whose shape then only made up for
    the difference.
    """
    dropped: list[Term] = []
    index = 0
    while index < len(choices) and len(choices) > 1:
        own = choices[index].trial.term
        rivals = [k for k, other in enumerate(choices) if k > index and other.trial.term.law.shape
                  and other.trial.term.law.against == own.law.against
                  and not other.trial.term.law.repeats]
        now = stages[-1].squares(look.blocks)
        better = None if any(own.law.name in c.trial.term.law.requires for c in choices) else next(
            (found for k in rivals if (found := _without(
                start, choices, stages[-1], index, k, look, now)) is not None), None)
        if better is None:
            index += 1
            continue
        look.report(f"{own.law.name} is not missed")
        dropped.append(own)
        choices, stages = better
    return choices, stages, dropped


def _one_for_two(
    start: InputBalance, choices: list[LawChoice], stages: list[InputBalance], look: Look
) -> tuple[list[LawChoice], list[InputBalance], list[Term]]:
    """Return the choices with one law in place of two against the same, if it leaves no more.

    A pendulum is a spring that softens, until it swings far.
    """
    end, first = stages[-1], len(start.terms)
    now = end.squares(look.blocks)
    for index, one in enumerate(choices):
        for k in range(index + 1, len(choices)):
            pair = one.trial.term.law, choices[k].trial.term.law
            others = [c for j, c in enumerate(choices) if j not in (index, k)]
            if pair[0].against != pair[1].against or {law.name for law in pair} & {
                    name for c in others for name in c.trial.term.law.requires}:
                continue
            rest = end.without(first + k).without(first + index)
            good = [t for t in choose(rest, look)[1] if t.significant and t.companion is None
                    and t.term.law.against == pair[0].against
                    and t.squares.sum() < now + least_loss(end, now)]
            if not good or good[0].term.law in pair:
                continue
            equivalent = equivalents(
                rest, look.blocks, good[0], good, look.blocks.sums(rest.held_out(look.blocks)**2))
            tried, after = _polished(start, [*others, LawChoice(
                trial=good[0], equivalent=equivalent, trials=tuple(good))], look.blocks)
            look.report(f"{good[0].name} in place of {pair[0].name} and {pair[1].name}")
            return tried, after, [one.trial.term, choices[k].trial.term]
    return choices, stages, []


def _without(
    start: InputBalance, choices: list[LawChoice], end: InputBalance, index: int, rival: int,
    look: Look, now: float,
) -> tuple[list[LawChoice], list[InputBalance]] | None:
    """Return the choices without one, another one placed anew; None where that leaves more."""
    term = choices[rival].trial.term
    first = len(start.terms)
    rest = end.without(first + rival).without(first + index)  # the rival is the later one
    placed = refined(rest, best_placed(rest, term.law))
    others = [replace(c, trial=replace(c.trial, term=placed)) if k == rival else c
              for k, c in enumerate(choices) if k != index]
    others, stages = _polished(start, others, look.blocks)
    most = now + least_loss(end, now)
    return (others, stages) if stages[-1].squares(look.blocks) < most else None


def _exchanged(
    start: InputBalance, choices: list[LawChoice], stages: list[InputBalance], look: Look
) -> tuple[list[LawChoice], list[InputBalance]] | None:
    """Return the choices with one law in place of another that explains clearly more."""
    first = len(start.terms)
    if not 2 <= len(choices) <= MOST_TO_EXCHANGE:
        return None
    before = stages[-1].squares(look.blocks)
    for index, old in enumerate(choices):
        name = old.trial.term.law.name
        others = choices[:index] + choices[index + 1:]
        if any(name in other.trial.term.law.requires for other in others):
            continue
        choice, _ = choose(stages[-1].without(first + index), look)
        if choice is None or choice.trial.term.law.name == name:
            continue
        others += _one_by_one(choice)
        tried = rebuilt(start, others, look.blocks)
        if tried[-1].squares(look.blocks) < CLEARLY_LESS * before:
            look.report(f"{choice.trial.name} in place of {name}")
            return _polished(start, others, look.blocks)
    return None


def _polished(
    start: InputBalance, choices: list[LawChoice], blocks: Blocks
) -> tuple[list[LawChoice], list[InputBalance]]:
    """Return choices whose shapes suit one another, and the stages that they make."""
    stages = rebuilt(start, choices, blocks)
    for index, choice in enumerate(choices[:-1]):
        term = choice.trial.term
        others = stages[-1].without(len(start.terms) + index)
        better = refined(others, term)
        if better.key != term.key:
            choices[index] = replace(choice, trial=replace(choice.trial, term=better))
            stages = rebuilt(start, choices, blocks)
    return choices, stages


def _one_by_one(choice: LawChoice) -> list[LawChoice]:
    """Return a choice of two laws as two steps."""
    trial = choice.trial
    if trial.companion is None:
        return [choice]
    plain = replace(trial, companion=None)
    sharper = replace(plain, term=trial.companion, name=trial.companion.law.name)
    trials = tuple(plain if t is trial else t for t in choice.trials)
    return [LawChoice(trial=plain, equivalent=choice.equivalent, trials=trials),
            LawChoice(trial=sharper, equivalent=(), trials=(sharper,))]


def pruned(
    start: InputBalance, choices: list[LawChoice], blocks: Blocks
) -> tuple[list[LawChoice], list[InputBalance], list[Term]]:
    """Return the choices that are missed if taken out, and the stages that they make."""
    dropped = prune(rebuilt(start, choices, blocks)[-1], blocks, len(start.terms))
    keys = {term.key for term in dropped}
    kept = [choice for choice in choices if choice.trial.term.key not in keys]
    return kept, rebuilt(start, kept, blocks), dropped


@dataclass(frozen=True, kw_only=True)
class Search:
    """What was added to a balance, step by step, and what is left."""

    stages: tuple[InputBalance, ...]
    """The balance at the start and after each step that was kept."""
    choices: tuple[LawChoice, ...]
    """One a step."""
    last_trials: tuple[Trial, ...]
    """What was tried at the end and not taken."""
    left: tuple[Left, ...]
    """Shapes of the residual at the end."""
    unknown: Left | None
    """What no law holds."""
    dropped: tuple[Term, ...]
    """Pruned, or given up as stand-ins for something unknown."""
    given_up: tuple[str, ...]

    @property
    def balance(self) -> InputBalance:
        """The balance at the end."""
        return self.stages[-1]


def search(
    start: InputBalance, blocks: Blocks, shapes: list[GenericShape], hidden: Collection[str],
    report: Callable[[str], None],
) -> Search:
    """Return what a balance lacks.

    Parameters
    ----------
    start : the known terms.
    blocks : what is held out together.
    shapes : nameless shapes in speed, position, load and time.
    hidden : collection of str
        Names that may not be used.
    report : takes a line for the person who waits.
    """
    smooth = [shape for shape in shapes if shape.order is None]
    look = Look(blocks=blocks, hidden=frozenset(hidden), report=report, smooth=smooth,
                freest=freest_columns(start.columns, smooth))
    stages, choices, trials, dropped = forward(start, look)
    left = _left(stages[-1], look, shapes)
    unknown = main_shape(left)
    given_up: list[str] = []
    if unknown is not None:
        first = len(start.terms)
        stand_ins = mimics(stages[-1], blocks, unknown, first)
        if stand_ins:
            given_up = [stages[-1].terms[index].law.name for index in stand_ins]
            choices = [c for k, c in enumerate(choices) if first + k not in stand_ins]
            choices, stages, more = pruned(start, choices, blocks)
            dropped += more
            left = _left(stages[-1], look, shapes)
            unknown = main_shape(left) or unknown
    return Search(
        stages=tuple(stages), choices=tuple(choices), last_trials=trials, left=tuple(left),
        unknown=unknown, dropped=tuple(dropped), given_up=tuple(dict.fromkeys(given_up)))


def _left(end: InputBalance, look: Look, shapes: list[GenericShape]) -> list[Left]:
    look.report("looking at what is left")
    in_time = waves_in_time(end.design.trajectory, end.fit.residual, look.freest)
    return portrait(end, look.blocks, [*shapes, *in_time])


def whiteness(balance: InputBalance) -> tuple[np.ndarray, np.ndarray, float]:
    """Return lags (s), autocorrelation of the residual, and the bound of white noise."""
    residual = balance.fit.residual
    count = min(200, len(residual) // 4)
    full = autocorrelation(residual, count)
    return (np.arange(count) / balance.design.trajectory.row_rate,
            full / max(full[0], 1e-300), 1.96 / float(np.sqrt(len(residual))))
