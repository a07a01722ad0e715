"""One trial of a law: its refined shape, the clock of its input, and its equivalents.

Shapes are moved between the points of their grid. A lag of the motion behind the recorded input is
taken out where it is below one interval: a command that a digital controller holds acts half an
interval after it was recorded, and a multiplexer reads its channels one after the other. That is
how a record was made, not an effect of the axis; a lag of more than one interval is, and is named
``control_delay``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from ema_identification.rig.fit.balance import InputBalance, rms
from ema_identification.rig.fit.regression import Blocks
from ema_identification.rig.fit.sign_flips import orthonormal, squares_taken
from ema_identification.rig.laws.base import Law, Term
from ema_identification.rig.laws.dynamics import DELAY
from ema_identification.rig.laws.static import is_whole

TWICE = 2.0
"""Times the residual of one law that another may leave and still do instead of it."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One law that was tried in addition to a balance."""

    term: Term
    name: str
    companion: Term | None
    """A law that sharpens this one, tried and taken together with it."""
    p_value: float
    """After all looks of the step."""
    squares: np.ndarray
    """Held-out sum of squares of each block with it, shape (blocks,)."""
    rows: int
    gain: float
    """Share of the held-out squares that it takes."""
    significant: bool

    @property
    def complexity(self) -> int:
        """Number of free parameters."""
        own = self.term.law.complexity
        return own if self.companion is None else own + self.companion.law.complexity

    @property
    def score(self) -> float:
        """Held-out residual with it, rms."""
        return float(np.sqrt(self.squares.sum() / self.rows))


@dataclass(frozen=True, kw_only=True)
class LawChoice:
    """What one step chose, and what it compared."""

    trial: Trial
    equivalent: tuple[str, ...]
    trials: tuple[Trial, ...]
    """All that were held out, best first."""
    contested: bool = False
    """Whether a law that filters the motion took more, and had to wait."""


def standard_error(differences: np.ndarray) -> float:
    """Return the standard error of a sum over blocks, of their differences, shape (blocks,)."""
    return float(np.sqrt(len(differences)) * np.std(differences, ddof=1))


EVALUATIONS = 14


def refined(balance: InputBalance, term: Term) -> Term:
    """Return the term with its shape moved between the neighbours on the grid.

    One parameter after the other; several until they stay, since the best of one depends on the
    others: a frequency that is off looks like damping. Whole numbers a turn stay whole; a
    parameter with one point on its grid is returned as it is.
    """
    for _ in range(ITERATIONS if len(term.shape) > 1 else 1):
        before = term.shape
        for place in range(len(term.shape)):
            term = _shape_moved(balance, term, place)
        if np.allclose(term.shape, before, rtol=CLOSE, atol=0.0):
            break
    return term


def _shape_moved(balance: InputBalance, term: Term, place: int) -> Term:
    """Return the term with one parameter of its shape moved."""
    trajectory = balance.design.trajectory
    grid = sorted({shape[place] for shape in term.law.grid(trajectory)})
    if len(grid) < 2:
        return term
    value = term.shape[place]
    whole = term.law.periodic and not term.law.looked_for
    turns = trajectory.turns if trajectory.axis.motion == "rotary" else None
    if whole and turns is not None and is_whole(value, turns):
        return Term(law=term.law, shape=(float(round(value)),))
    basis = orthonormal(balance.free_columns)
    residual = balance.target - basis @ (basis.T @ balance.target)
    near = value if len(term.shape) == 1 else min(grid, key=lambda g: abs(g - value))
    below = [g for g in grid if g < near]  # of several, one at a point of the grid may cross it
    above = [g for g in grid if g > near]
    spacing = min(b - a for a, b in zip(grid[:-1], grid[1:]))
    low = below[-1] if below else value - min(spacing, 0.9 * abs(value))
    high = above[0] if above else value + spacing

    def at(candidate: float) -> Term:
        return Term(law=term.law, shape=(*term.shape[:place], candidate, *term.shape[place + 1:]))

    def left(candidate: float) -> float:
        return -squares_taken(balance.design.columns(at(candidate), trajectory), basis, residual)

    found = optimize.minimize_scalar(
        left, bounds=(low, high), method="bounded", options={"maxiter": EVALUATIONS})
    best = float(found.x) if found.fun < left(value) else value
    if whole and turns is not None and is_whole(best, turns):
        best = float(round(best))
    return at(best)


def best_placed(balance: InputBalance, law: Law) -> Term:
    """Return a law with the shape of its grid that leaves least beside a balance."""
    terms = [Term(law=law, shape=tuple(shape)) for shape in law.grid(balance.design.trajectory)]
    balance.design.evaluate(terms)
    basis = orthonormal(balance.free_columns)
    residual = balance.target - basis @ (basis.T @ balance.target)
    return max(terms, key=lambda term: squares_taken(
        balance.design.columns(term), basis, residual))


MOST = 1.0
"""Sampling intervals that a lag may have to be one of the record."""
ITERATIONS = 6
"""Of a lag, and of a shape, at most."""
SHIFTS = (-0.2, -0.1, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.3, 1.6)
"""Shifts tried, in units of rms speed over rms acceleration: a radian of the motion."""
CLOSE = 1e-3
"""Change of a lag at which the iteration ends, in sampling intervals; of a shape, relative."""
_DELAY = Term(law=DELAY)


def without_skew(balance: InputBalance, blocks: Blocks) -> InputBalance:
    """Return the balance with its input later by what fits best, up to one interval.

    Only where blocks that are held out agree. A balance that has a delay or a lag among its
    terms is returned as it is.
    """
    if {DELAY.name, "drive_lag"} & set(balance.names) or not balance.terms:
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
    return moved if moved.squares(blocks) < plain.squares(blocks) else plain


def with_whole_delay(balance: InputBalance) -> InputBalance:
    """Return the balance with its delay as a shift in time, not as a slope.

    What is left to the slope's coefficient is a small correction of that shift. A delay that is
    new is first looked for among shifts: its slope alone may be taken for inertia.
    """
    if DELAY.name not in balance.names:
        return balance
    index = balance.names.index(DELAY.name)
    place = balance.span(index).start
    interval = balance.design.trajectory.interval
    if abs(balance.design.lead) <= MOST * interval:
        balance = balance.later(_best_shift(balance, index), place)
    for _ in range(ITERATIONS):
        change = float(balance.fit.coefficients[place])
        balance = balance.later(change, place)
        if abs(change) < CLOSE * interval:
            break
    return balance


def _best_shift(balance: InputBalance, index: int) -> float:
    """Return the change of the input's lead (s), of a few within bounds, that fits best."""
    place = balance.span(index).start
    trajectory = balance.design.trajectory
    slow = rms(trajectory.speed) / max(rms(trajectory.acceleration), 1e-300)
    low, high = balance.bounds.low[place], balance.bounds.high[place]
    changes = [0.0, *(float(share * slow) for share in SHIFTS if low <= share * slow <= high)]
    plain = balance.without(index)
    residuals = [plain.led(balance.design.lead + change).fit.residual for change in changes]
    return changes[int(np.argmin([float(residual @ residual) for residual in residuals]))]


def skew_words(balance: InputBalance) -> tuple[str, ...]:
    """Return what was done to the clock of the input, for people."""
    lead = balance.design.lead
    if lead == 0.0 or DELAY.name in balance.names:
        return ()
    share = lead / balance.design.trajectory.interval
    return (f"input taken {1e3 * lead:.3g} ms later ({share:.2f} of a sampling interval), where "
            "it agrees best with the motion",)


SAME = 0.8
"""Laws of one set take this share of what the chosen one takes, at least."""
SEPARATED = 1.645
"""Standard errors beyond which the data tell two laws apart."""
OVERLAP = 0.2
"""Laws are one set if either, after the other, adds less than this share of its gain."""
MAX_EQUIVALENT = 2


def equivalents(
    balance: InputBalance, blocks: Blocks, chosen: Trial, good: list[Trial], squares: np.ndarray
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
        after = joined.squares_beside(joined.columns_of(trial.term), blocks)
        extra = (chosen.squares.sum() - after) / squares.sum()
        if extra < OVERLAP * trial.gain:
            names.append(trial.name)
            names += trial.term.law.equivalent(balance.design.trajectory.axis, trial.term.shape)
    unique = [name for name in dict.fromkeys(names) if name != chosen.name]
    return tuple(unique[:MAX_EQUIVALENT])
