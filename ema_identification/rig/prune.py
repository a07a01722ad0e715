"""Step `prune`: laws that nothing misses once the others are there."""

from __future__ import annotations

from ema_identification.rig.balance import Balance
from ema_identification.rig.blocks import Blocks
from ema_identification.rig.laws import Term

LEAST_LOSS = 0.02
"""Share of the held-out squares by which they rise, at least, without a law that stays."""


def prune(
    balance: Balance, blocks: Blocks, protected: int
) -> tuple[Balance, list[Term]]:
    """Return the balance without added terms that held-out blocks do not miss.

    Parameters
    ----------
    balance : Balance
        With all that was added.
    blocks : Blocks
        What is held out together.
    protected : int
        So many terms at the front are the model's own and stay.

    """
    dropped: list[Term] = []
    while len(balance.terms) > protected:
        squares = blocks.sums(balance.held_out(blocks) ** 2)
        worst, least = None, LEAST_LOSS
        for index in range(protected, len(balance.terms)):
            if any(balance.terms[index].law.name in other.law.requires
                   for other in balance.terms):
                continue
            smaller = balance.without(index)
            own = blocks.sums(smaller.held_out(blocks) ** 2)
            loss = own.sum() / squares.sum() - 1.0
            if loss < least:
                worst, least = index, loss
        if worst is None:
            break
        dropped.append(balance.terms[worst])
        balance = balance.without(worst)
    return balance, dropped
