"""Step `name`: which law the balance lacks, tried one by one on held-out blocks."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.rig.balance import BASE_LAWS, Balance
from ema_identification.rig.blocks import Blocks
from ema_identification.rig.laws import LAWS, Law, Term
from ema_identification.rig.refine import refined
from ema_identification.rig.regression import held_out
from ema_identification.rig.shapes import GenericShape
from ema_identification.rig.sign_flips import screen

LEVEL_OF_CHANCE = 0.005
"""Highest p-value, after all looks of a step, at which something is named."""
LEAST_GAIN = 0.04
"""Least share of the held-out squares that a law must take to be worth naming."""
UNCERTAINTY = 2.0
"""Standard errors by which a law must better the held-out residual."""
PARSIMONY = 0.75
"""A law of fewer parameters is taken first if it takes this share of what the best takes."""
SAME = 0.8
"""Laws of one set take this share of what the chosen one takes, at least."""
SEPARATED = 1.645
"""Standard errors beyond which the data tell two laws apart."""
OVERLAP = 0.2
"""Laws are one set if either, after the other, adds less than this share of its gain."""
OUTDONE = 0.5
"""Share that a law takes, at least, of what a smooth shape against the same quantity takes."""
PLAIN_SHAPES = ("speed and direction", "position", "angle within a turn")
MAX_TRIED = 12
MAX_EQUIVALENT = 2

Reporter = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One law that was tried in addition to a balance."""

    term: Term
    name: str
    p_value: float
    """After all looks of the step."""
    squares: np.ndarray
    """Held-out sum of squares of each block with it, shape (blocks,)."""
    rows: int
    gain: float
    """Share of the held-out squares that it takes."""
    significant: bool

    @property
    def score(self) -> float:
        """Held-out residual with it, rms."""
        return float(np.sqrt(self.squares.sum() / self.rows))


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What one step chose, and what it compared."""

    trial: Trial
    equivalent: tuple[str, ...]
    trials: tuple[Trial, ...]
    """All that were held out, best first."""


def candidate_terms(balance: Balance, hidden: Collection[str]) -> list[tuple[str, Term]]:
    """Return what may be added to a balance: (name under which it is reported, term)."""
    present = {term.law.name for term in balance.terms}
    keys = {term.key for term in balance.terms}
    trajectory = balance.design.trajectory
    found: list[tuple[str, Term]] = []
    for law in LAWS.values():
        if law.name in BASE_LAWS:
            name = _base_candidate(balance, law)
            if name and name not in hidden:
                found.append((name, Term(law=law)))
            continue
        if law.name in hidden or (law.name in present and not law.repeats):
            continue
        if not law.applies(trajectory) or not set(law.requires) <= present:
            continue
        if law.of_prediction and not balance.terms:
            continue
        found += [(law.name, Term(law=law, shape=tuple(shape)))
                  for shape in law.grid(trajectory)
                  if Term(law=law, shape=tuple(shape)).key not in keys]
    return found


def _base_candidate(balance: Balance, law: Law) -> str | None:
    """Return the name for a known term that is missing, or stands at its bound."""
    for index, term in enumerate(balance.terms):
        if term.law.name == law.name:
            at_bound = balance.fixed[balance.span(index)].any()
            if not at_bound:
                return None
            return "inertia_change" if law.name == "inertia" else law.name
    if law.name == "disturbance" and not balance.design.trajectory.has_disturbance:
        return None
    return law.name


def choose(
    balance: Balance, blocks: Blocks, hidden: Collection[str], report: Reporter,
    shapes: Sequence[GenericShape] = (),
) -> tuple[Choice | None, tuple[Trial, ...]]:
    """Return the law that a balance lacks, None where none is worth naming; and all trials.

    Parameters
    ----------
    balance : Balance
        The model so far.
    blocks : Blocks
        What is held out together.
    hidden : collection of str
        Names that may not be used.
    report : callable
        Takes a line for the person who waits.
    shapes : sequence of GenericShape
        Smooth shapes; a law that takes less than half of what such a shape takes against the
        same quantity is not the law.

    """
    candidates = candidate_terms(balance, hidden)
    if not candidates:
        return None, ()
    report(f"screening {len(candidates)} regressors")
    columns = [_columns(balance, term) for _, term in candidates]
    found = screen(columns, balance.free_columns, balance.fit.residual, blocks)
    before = balance.held_out(blocks)
    squares = blocks.sums(before**2)
    trials: list[Trial] = []
    lawful = np.array([
        not term.law.positive or bool((own >= 0.0).all())
        for (_, term), own in zip(candidates, found.coefficients)
    ])
    for index in _worth_trying(candidates, np.where(lawful, found.gain, -np.inf)):
        name, term = candidates[index]
        p_value = float(found.family_p_value[index])
        term = refined(balance, term)
        joined = balance.joined(term)
        own = blocks.sums(joined.held_out(blocks) ** 2)
        gain = 1.0 - own.sum() / squares.sum()
        error = _standard_error(squares - own)
        trials.append(Trial(
            term=term, name=name, p_value=p_value, squares=own, rows=len(before), gain=gain,
            significant=bool(p_value <= LEVEL_OF_CHANCE and gain >= LEAST_GAIN
                             and (squares - own).sum() > UNCERTAINTY * error
                             and (joined.lawful or not balance.lawful))))
    trials.sort(key=lambda trial: -trial.gain)
    good = [trial for trial in trials if trial.significant]
    if good:
        most = _taken_by_shapes(balance, blocks, shapes, float(squares.sum()))
        good = [trial for trial in good
                if trial.gain >= OUTDONE * most.get(trial.term.law.against, 0.0)]
    if not good:
        return None, tuple(trials)
    chosen = _simplest(good, {term.law.name for term in balance.terms})
    return Choice(trial=chosen, equivalent=_equivalent(balance, blocks, chosen, good, squares),
                  trials=tuple(trials)), tuple(trials)


def _taken_by_shapes(
    balance: Balance, blocks: Blocks, shapes: Sequence[GenericShape], squares: float
) -> dict[str, float]:
    """Return the share of the held-out squares that smooth shapes take, by what they follow."""
    most: dict[str, float] = {}
    for shape in shapes:
        if shape.order is None and shape.label in PLAIN_SHAPES:
            after = held_out(np.column_stack([balance.free_columns, shape.columns]),
                             balance.target, blocks)
            gain = 1.0 - float(after @ after) / squares
            most[shape.against] = max(gain, most.get(shape.against, 0.0))
    return most


def _columns(balance: Balance, term: Term) -> np.ndarray:
    if term.law.of_prediction:
        return balance.design.of_prediction(term, balance.terms)
    return balance.design.columns(term)


def _worth_trying(candidates: list[tuple[str, Term]], gain: np.ndarray) -> list[int]:
    """Return the best shape of each law, best first."""
    best: dict[str, int] = {}
    for index in np.argsort(-gain):
        best.setdefault(candidates[index][0], int(index))
    return [index for index in best.values() if np.isfinite(gain[index])][:MAX_TRIED]


def _standard_error(differences: np.ndarray) -> float:
    """Return the standard error of a sum over blocks."""
    return float(np.sqrt(len(differences)) * np.std(differences, ddof=1))


def _simplest(good: list[Trial], present: set[str]) -> Trial:
    """Return the simplest law that takes nearly as much as the best; more comes in later steps.

    Another wave of a law that the model has is no new mechanism and counts as simplest.
    """
    best = good[0]
    near = [trial for trial in good if trial.gain >= PARSIMONY * best.gain]
    return min(near, key=lambda trial: (
        trial.name not in present, trial.term.law.complexity, -trial.gain))


def _equivalent(
    balance: Balance, blocks: Blocks, chosen: Trial, good: list[Trial], squares: np.ndarray
) -> tuple[str, ...]:
    """Return other names that the data cannot tell from the chosen one."""
    names = list(chosen.term.law.equivalent(balance.design.trajectory.axis, chosen.term.shape))
    joined = balance.joined(chosen.term)
    for trial in good:
        if trial is chosen or trial.name == chosen.name:
            continue
        difference = trial.squares - chosen.squares
        tied = difference.sum() <= SEPARATED * _standard_error(difference)
        simple = trial.term.law.complexity <= chosen.term.law.complexity
        if trial.gain < SAME * chosen.gain or not (tied or simple):
            continue
        after = held_out(
            np.column_stack([joined.free_columns, _columns(joined, trial.term)]), joined.target,
            blocks)
        extra = (chosen.squares.sum() - float(after @ after)) / squares.sum()
        if extra < OVERLAP * trial.gain:
            names.append(trial.name)
            names += trial.term.law.equivalent(balance.design.trajectory.axis, trial.term.shape)
    unique = [name for name in dict.fromkeys(names) if name != chosen.name]
    return tuple(unique[:MAX_EQUIVALENT])


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
        worst, least = None, 0.5 * LEAST_GAIN
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
