"""Lag of the motion behind the recorded input: taken out where it is below one interval.

A command that a digital controller holds acts half an interval after it was recorded, and
a multiplexer reads its channels one after the other. That is how a record was made, not an
effect of the axis; a lag of more than one interval is, and is named ``control_delay``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ema_identification.rig.balance import Balance
from ema_identification.rig.blocks import Blocks
from ema_identification.rig.laws import LAWS, Term

MOST = 1.0
"""Sampling intervals that a lag may have to be one of the record."""
ITERATIONS = 6
CLOSE = 1e-3
"""Change of a lag at which the iteration ends, in sampling intervals."""
_DELAY = Term(law=LAWS["control_delay"])
_LAG = "drive_lag"


def delay_index(balance: Balance) -> int | None:
    """Return the index of the model's own delay, None where it has none."""
    names = [term.law.name for term in balance.terms]
    return names.index(_DELAY.law.name) if _DELAY.law.name in names else None


def without_skew(balance: Balance, blocks: Blocks) -> Balance:
    """Return the balance with its input later by what fits best, up to one interval.

    Only where blocks that are held out agree. A balance that has a delay or a lag among its
    terms is returned as it is.
    """
    if delay_index(balance) is not None or _LAG in balance.names or not balance.terms:
        return balance
    lead = balance.design.lead
    for _ in range(ITERATIONS):
        joined = balance.led(lead).joined(_DELAY)
        if joined.fixed[-1]:
            break
        change = float(joined.fit.coefficients[-1])
        lead += change
        if abs(change) < CLOSE * balance.design.trajectory.interval:
            break
    plain = balance.led(0.0)
    if abs(lead) > MOST * balance.design.trajectory.interval:
        return plain
    moved = balance.led(lead)
    squares = [float(np.sum(b.held_out(blocks) ** 2)) for b in (plain, moved)]
    return moved if squares[1] < squares[0] else plain


def with_whole_delay(balance: Balance) -> Balance:
    """Return the balance with its delay as a shift in time, not as a slope.

    What is left to the slope's coefficient is a small correction of that shift.
    """
    index = delay_index(balance)
    if index is None:
        return balance
    place = balance.span(index).start
    for _ in range(ITERATIONS):
        change = float(balance.fit.coefficients[place])
        bounds = replace(balance.bounds, low=balance.bounds.low.copy(),
                         high=balance.bounds.high.copy())
        bounds.low[place] -= change
        bounds.high[place] -= change
        balance = replace(balance.led(balance.design.lead + change), bounds=bounds)
        if abs(change) < CLOSE * balance.design.trajectory.interval:
            break
    return balance


def skew_words(balance: Balance) -> tuple[str, ...]:
    """Return what was done to the clock of the input, for people."""
    lead = balance.design.lead
    if lead == 0.0 or delay_index(balance) is not None:
        return ()
    share = lead / balance.design.trajectory.interval
    return (f"input taken {1e3 * lead:.3g} ms later ({share:.2f} of a sampling interval), where "
            "it agrees best with the motion",)
