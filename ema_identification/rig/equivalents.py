"""Which other laws the data cannot tell from a chosen one."""

from __future__ import annotations

import numpy as np

from ema_identification.rig.balance import Balance
from ema_identification.rig.blocks import Blocks
from ema_identification.rig.regression import held_out
from ema_identification.rig.skew import with_whole_delay
from ema_identification.rig.trials import TWICE, Trial, standard_error

SAME = 0.8
"""Laws of one set take this share of what the chosen one takes, at least."""
SEPARATED = 1.645
"""Standard errors beyond which the data tell two laws apart."""
OVERLAP = 0.2
"""Laws are one set if either, after the other, adds less than this share of its gain."""
MAX_EQUIVALENT = 2


def equivalents(
    balance: Balance, blocks: Blocks, chosen: Trial, good: list[Trial], squares: np.ndarray
) -> tuple[str, ...]:
    """Return other names that the data cannot tell from the chosen one."""
    names = list(chosen.term.law.equivalent(balance.design.trajectory.axis, chosen.term.shape))
    joined = with_whole_delay(balance.joined(chosen.term))
    if chosen.companion is not None:
        joined = joined.joined(chosen.companion)
    for trial in good:
        if trial is chosen or trial.name == chosen.name or trial.companion is not None:
            continue
        if trial.term.law.dynamic and not chosen.term.law.dynamic:
            continue  # a filter takes a little of anything: no rival of what is plain
        if chosen.companion is not None and trial.name == chosen.companion.law.name:
            continue
        difference = trial.squares - chosen.squares
        tied = difference.sum() <= SEPARATED * standard_error(difference)
        simple = trial.complexity <= chosen.complexity
        near = simple and trial.score <= TWICE * chosen.score
        if trial.gain < SAME * chosen.gain or not (tied or near):
            continue
        after = held_out(
            np.column_stack([joined.free_columns, joined.columns_of(trial.term)]), joined.target,
            blocks)
        extra = (chosen.squares.sum() - float(after @ after)) / squares.sum()
        if extra < OVERLAP * trial.gain:
            names.append(trial.name)
            names += trial.term.law.equivalent(balance.design.trajectory.axis, trial.term.shape)
    unique = [name for name in dict.fromkeys(names) if name != chosen.name]
    return tuple(unique[:MAX_EQUIVALENT])
