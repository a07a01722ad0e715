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
SHIFTS = (-0.2, -0.1, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.3, 1.6)
"""Shifts tried, in units of rms speed over rms acceleration: a radian of the motion."""
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

    What is left to the slope's coefficient is a small correction of that shift. A delay that is
    new is first looked for among shifts: its slope alone may be taken for inertia.
    """
    index = delay_index(balance)
    if index is None:
        return balance
    place = balance.span(index).start
    interval = balance.design.trajectory.interval
    if abs(balance.design.lead) <= MOST * interval:
        balance = _moved(balance, place, _best_shift(balance, index))
    for _ in range(ITERATIONS):
        change = float(balance.fit.coefficients[place])
        balance = _moved(balance, place, change)
        if abs(change) < CLOSE * interval:
            break
    return balance


def _moved(balance: Balance, place: int, change: float) -> Balance:
    """Return the balance with its input later by `change` (s), and its delay smaller by that."""
    if change == 0.0:
        return balance
    bounds = replace(balance.bounds, low=balance.bounds.low.copy(),
                     high=balance.bounds.high.copy())
    bounds.low[place] -= change
    bounds.high[place] -= change
    return replace(balance.led(balance.design.lead + change), bounds=bounds)


def _best_shift(balance: Balance, index: int) -> float:
    """Return the change of the input's lead (s), of a few within bounds, that fits best."""
    place = balance.span(index).start
    trajectory = balance.design.trajectory
    hard = float(np.sqrt(np.mean(trajectory.acceleration**2)))
    slow = float(np.sqrt(np.mean(trajectory.speed**2))) / max(hard, 1e-300)
    low, high = balance.bounds.low[place], balance.bounds.high[place]
    changes = [0.0, *(float(share * slow) for share in SHIFTS if low <= share * slow <= high)]
    plain = balance.without(index)
    residuals = [plain.led(balance.design.lead + change).fit.residual for change in changes]
    return changes[int(np.argmin([float(residual @ residual) for residual in residuals]))]


def skew_words(balance: Balance) -> tuple[str, ...]:
    """Return what was done to the clock of the input, for people."""
    lead = balance.design.lead
    if lead == 0.0 or delay_index(balance) is not None:
        return ()
    share = lead / balance.design.trajectory.interval
    return (f"input taken {1e3 * lead:.3g} ms later ({share:.2f} of a sampling interval), where "
            "it agrees best with the motion",)
