"""Steps `name` and `add`, again and again: forward one law at a time, then prune."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from ema_identification.rig.balance import Balance
from ema_identification.rig.blocks import Blocks
from ema_identification.rig.laws import Term
from ema_identification.rig.remainder import Left, main_shape, mimics, portrait
from ema_identification.rig.selection import Choice, Trial, choose, prune
from ema_identification.rig.shapes import GenericShape, waves_in_time

MAX_ADDED = 12
MAX_RESTARTS = 3


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
    given_up: list[str] = []
    for _ in range(MAX_RESTARTS + 1):
        stages, choices, trials, dropped = _forward(
            start, blocks, {*hidden, *given_up}, report)
        end = stages[-1]
        report("looking at what is left")
        time_waves = waves_in_time(end.design.trajectory, end.fit.residual)
        left = portrait(end, blocks, [*shapes, *time_waves])
        unknown = main_shape(left)
        if unknown is None:
            break
        stand_ins = mimics(end, blocks, unknown, len(start.terms))
        names = {end.terms[index].law.name for index in stand_ins} - set(given_up)
        if not names:
            break
        given_up += sorted(names)
    return Search(
        stages=tuple(stages), choices=tuple(choices), last_trials=trials, left=tuple(left),
        unknown=unknown, dropped=tuple(dropped), given_up=tuple(given_up))


def _forward(
    start: Balance, blocks: Blocks, hidden: set[str], report: Callable[[str], None]
) -> tuple[list[Balance], list[Choice], tuple[Trial, ...], list[Term]]:
    """Add laws while they help, then drop those that are not missed."""
    balance, stages = start, [start]
    choices: list[Choice] = []
    trials: tuple[Trial, ...] = ()
    while len(choices) < MAX_ADDED:
        choice, trials = choose(balance, blocks, hidden, report)
        if choice is None:
            break
        report(f"found {choice.trial.name}")
        balance = balance.joined(choice.trial.term)
        choices.append(choice)
        stages.append(balance)
    pruned, dropped = prune(balance, blocks, len(start.terms))
    if dropped:
        keys = {term.key for term in dropped}
        choices = [c for c in choices if c.trial.term.key not in keys]
        stages = [start]
        for choice in choices:
            stages.append(stages[-1].joined(choice.trial.term))
    return stages, choices, trials, dropped


def whiteness(balance: Balance) -> tuple[np.ndarray, np.ndarray, float]:
    """Return lags (s), autocorrelation of the residual, and the bound of white noise."""
    residual = balance.fit.residual - balance.fit.residual.mean()
    count = min(200, len(residual) // 4)
    size = 1 << int(np.ceil(np.log2(2 * len(residual))))
    full = np.fft.irfft(np.abs(np.fft.rfft(residual, size)) ** 2)[:count]
    return (np.arange(count) / balance.design.trajectory.row_rate,
            full / max(full[0], 1e-300), 1.96 / float(np.sqrt(len(residual))))
