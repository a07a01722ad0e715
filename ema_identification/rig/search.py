"""What a balance lacks: laws with a name, then shapes without one."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from ema_identification.rig.balance import Balance
from ema_identification.rig.blocks import Blocks
from ema_identification.rig.forward import Look, forward, pruned
from ema_identification.rig.laws import Term
from ema_identification.rig.remainder import Left, main_shape, mimics, portrait
from ema_identification.rig.shapes import GenericShape, freest_columns, waves_in_time
from ema_identification.rig.trials import Choice, Trial


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
    look = Look(blocks=blocks, hidden=frozenset(hidden), report=report, smooth=smooth,
                freest=freest)
    stages, choices, trials, dropped = forward(start, look)
    left = _left(stages[-1], blocks, shapes, freest, report)
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


def whiteness(balance: Balance) -> tuple[np.ndarray, np.ndarray, float]:
    """Return lags (s), autocorrelation of the residual, and the bound of white noise."""
    residual = balance.fit.residual - balance.fit.residual.mean()
    count = min(200, len(residual) // 4)
    size = 1 << int(np.ceil(np.log2(2 * len(residual))))
    full = np.fft.irfft(np.abs(np.fft.rfft(residual, size)) ** 2)[:count]
    return (np.arange(count) / balance.design.trajectory.row_rate,
            full / max(full[0], 1e-300), 1.96 / float(np.sqrt(len(residual))))
