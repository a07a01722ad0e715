"""Steps `name` and `add`, again and again: forward one law at a time, then prune."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from ema_identification.rig.balance import Balance
from ema_identification.rig.blocks import Blocks
from ema_identification.rig.laws import Term
from ema_identification.rig.refine import refined
from ema_identification.rig.remainder import Left, main_shape, mimics, portrait
from ema_identification.rig.selection import Choice, Trial, choose, prune
from ema_identification.rig.shapes import GenericShape, freest_columns, waves_in_time
from ema_identification.rig.skew import with_whole_delay, without_skew

MAX_ADDED = 12


@dataclass(frozen=True, kw_only=True)
class Search:
    """What was added to a balance, step by step, and what is left."""

    stages: tuple[Balance, ...]
    """The balance at the start and after each step that was kept."""
    choices: tuple[Choice, ...]
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
    def balance(self) -> Balance:
        """The balance at the end."""
        return self.stages[-1]


def search(
    start: Balance, blocks: Blocks, shapes: list[GenericShape], hidden: Collection[str],
    report: Callable[[str], None],
) -> Search:
    """Return what a balance lacks.

    Parameters
    ----------
    start : Balance
        The known terms.
    blocks : Blocks
        What is held out together.
    shapes : list of GenericShape
        Nameless shapes in speed, position, load and time.
    hidden : collection of str
        Names that may not be used.
    report : callable
        Takes a line for the person who waits.

    """
    smooth = [shape for shape in shapes if shape.order is None]
    freest = freest_columns(start.columns, smooth)
    stages, choices, trials, dropped = _forward(
        start, blocks, set(hidden), report, smooth)
    left = _left(stages[-1], blocks, shapes, freest, report)
    unknown = main_shape(left)
    given_up: list[str] = []
    if unknown is not None:
        first = len(start.terms)
        stand_ins = mimics(stages[-1], blocks, unknown, first)
        if stand_ins:
            given_up = [stages[-1].terms[index].law.name for index in stand_ins]
            choices = [c for k, c in enumerate(choices) if first + k not in stand_ins]
            choices, stages, more = _pruned(start, choices, blocks)
            dropped += more
            left = _left(stages[-1], blocks, shapes, freest, report)
            unknown = main_shape(left) or unknown
    return Search(
        stages=tuple(stages), choices=tuple(choices), last_trials=trials, left=tuple(left),
        unknown=unknown, dropped=tuple(dropped), given_up=tuple(dict.fromkeys(given_up)))


def _left(
    end: Balance, blocks: Blocks, shapes: list[GenericShape], freest: np.ndarray,
    report: Callable[[str], None],
) -> list[Left]:
    report("looking at what is left")
    in_time = waves_in_time(end.design.trajectory, end.fit.residual, freest)
    return portrait(end, blocks, [*shapes, *in_time])


def _rebuilt(start: Balance, choices: list[Choice], blocks: Blocks) -> list[Balance]:
    stages = [start]
    for choice in choices:
        stages.append(_added(stages[-1], choice.trial.term, blocks))
    return stages


def _added(balance: Balance, term: Term, blocks: Blocks) -> Balance:
    """Return the balance with one more term, its input on the clock of the motion."""
    return without_skew(with_whole_delay(balance.joined(term)), blocks)


def _forward(
    start: Balance, blocks: Blocks, hidden: set[str], report: Callable[[str], None],
    smooth: list[GenericShape],
) -> tuple[list[Balance], list[Choice], tuple[Trial, ...], list[Term]]:
    """Add laws while they help, then drop those that are not missed."""
    balance, stages = start, [start]
    choices: list[Choice] = []
    trials: tuple[Trial, ...] = ()
    while len(choices) < MAX_ADDED:
        choice, trials = choose(balance, blocks, hidden, report, smooth)
        if choice is None:
            break
        for one in _one_by_one(choice):
            report(f"found {one.trial.name}")
            balance = _added(balance, one.trial.term, blocks)
            choices.append(one)
            stages.append(balance)
        choices, stages = _polished(start, choices, blocks)
        balance = stages[-1]
    choices, stages, dropped = _pruned(start, choices, blocks)
    return stages, choices, trials, dropped


def _polished(
    start: Balance, choices: list[Choice], blocks: Blocks
) -> tuple[list[Choice], list[Balance]]:
    """Return choices whose shapes suit one another, and the stages that they make."""
    stages = _rebuilt(start, choices, blocks)
    for index, choice in enumerate(choices[:-1]):
        term = choice.trial.term
        others = stages[-1].without(len(start.terms) + index)
        better = refined(others, term)
        if better.key != term.key:
            choices[index] = replace(choice, trial=replace(choice.trial, term=better))
            stages = _rebuilt(start, choices, blocks)
    return choices, stages


def _one_by_one(choice: Choice) -> list[Choice]:
    """Return a choice of two laws as two steps."""
    trial = choice.trial
    if trial.companion is None:
        return [choice]
    plain = replace(trial, companion=None)
    sharper = replace(plain, term=trial.companion, name=trial.companion.law.name)
    trials = tuple(plain if t is trial else t for t in choice.trials)
    return [Choice(trial=plain, equivalent=choice.equivalent, trials=trials),
            Choice(trial=sharper, equivalent=(), trials=(sharper,))]


def _pruned(
    start: Balance, choices: list[Choice], blocks: Blocks
) -> tuple[list[Choice], list[Balance], list[Term]]:
    """Return the choices that are missed if taken out, and the stages that they make."""
    _, dropped = prune(_rebuilt(start, choices, blocks)[-1], blocks, len(start.terms))
    keys = {term.key for term in dropped}
    kept = [choice for choice in choices if choice.trial.term.key not in keys]
    return kept, _rebuilt(start, kept, blocks), dropped


def whiteness(balance: Balance) -> tuple[np.ndarray, np.ndarray, float]:
    """Return lags (s), autocorrelation of the residual, and the bound of white noise."""
    residual = balance.fit.residual - balance.fit.residual.mean()
    count = min(200, len(residual) // 4)
    size = 1 << int(np.ceil(np.log2(2 * len(residual))))
    full = np.fft.irfft(np.abs(np.fft.rfft(residual, size)) ** 2)[:count]
    return (np.arange(count) / balance.design.trajectory.row_rate,
            full / max(full[0], 1e-300), 1.96 / float(np.sqrt(len(residual))))
