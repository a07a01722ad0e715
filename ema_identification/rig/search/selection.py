"""Which law to add next: candidates screened by sign flips, held out, the simplest first."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.rig.fit.balance import BASE_LAWS, InputBalance, rms
from ema_identification.rig.fit.estimates import parameters
from ema_identification.rig.fit.regression import Blocks
from ema_identification.rig.fit.sign_flips import LEVEL_OF_CHANCE, p_of_much, screen_by_sign_flips
from ema_identification.rig.laws import LAWS
from ema_identification.rig.laws.base import LOCATED, Law, Term
from ema_identification.rig.search.alternatives import (
    TWICE,
    LawChoice,
    Trial,
    equivalents,
    refined,
    standard_error,
    with_whole_delay,
)
from ema_identification.rig.search.shapes import GenericShape, waves_in_time
from ema_identification.rig.search.waves import wave_stands

Candidate = tuple[str, tuple[Term, ...]]
"""The name under which it is reported; a term, and one that sharpens it."""


def candidate_terms(
    balance: InputBalance, hidden: Collection[str], peaks: Sequence[float]
) -> list[Candidate]:
    """Return what may be added to a balance.

    Parameters
    ----------
    balance : the model so far.
    hidden : collection of str
        Names that may not be used.
    peaks : frequencies at which the residual has a wave in time (Hz).
    """
    present = {term.law.name for term in balance.terms}
    keys = {term.key for term in balance.terms}
    trajectory = balance.design.trajectory
    found: list[Candidate] = []
    for law in LAWS.values():
        if law.name in BASE_LAWS or (law.name in present and not law.repeats):
            name = _changed(balance, law)
            if name and name not in hidden:
                found.append((name, (_own(balance, law),)))
            continue
        if law.name in hidden or not law.applies(trajectory):
            continue
        if (law.of_prediction and not balance.terms) or present & set(law.excludes):
            continue
        needed = set(law.requires) - present
        if needed and (not law.sharpens or needed & set(hidden)):
            continue
        found += [(name, (Term(law=LAWS[name]), Term(law=law)))
                  for name in law.joins if name not in present and name not in hidden]
        before = tuple(Term(law=LAWS[name]) for name in sorted(needed))
        found += [(before[0].law.name if before else law.name,
                   (*before, Term(law=law, shape=tuple(shape))))
                  for shape in ([(f,) for f in peaks] if law.looked_for
                                else law.grid(trajectory))
                  if Term(law=law, shape=tuple(shape)).key not in keys]
    return found


def _own(balance: InputBalance, law: Law) -> Term:
    """Return the model's term of a law, or a new one."""
    return next((term for term in balance.terms if term.law.name == law.name), Term(law=law))


def _changed(balance: InputBalance, law: Law) -> str | None:
    """Return the name for a known term that is missing, or stands at its bound."""
    if law.name in balance.names:
        index = len(balance.terms) - 1 - balance.names[::-1].index(law.name)
        span = balance.span(index)
        at_bound = balance.fixed[span] & np.isfinite(balance.bounds.high[span])
        if not at_bound.any():
            return None
        return "inertia_change" if law.name == "inertia" else law.name
    if law.name == "disturbance" and not balance.design.trajectory.has_disturbance:
        return None
    return law.name


LEVEL_OF_MOST = 0.05
"""Likewise for a law that takes more than half of the held-out squares: what is so large is in
every flipped residual too, which hides it."""
NEARLY_ALL = 0.9
"""Share of the held-out squares from which a law is judged by what it leaves."""
LEAST_GAIN = 0.04
"""Least share of the held-out squares that a law must take to be worth naming."""
LEAST_OF_DYNAMIC = 0.15
"""Likewise for a law that filters the motion or the prediction, or that is looked for among the
peaks of the residual: it takes a little of anything."""
LEAST_SIZE = 0.01
"""Least rms of what it takes, over the rms of the input: less is within the error of scale of
a good transducer."""
UNCERTAINTY = 2.0
"""Standard errors by which a law must better the held-out residual."""
PARSIMONY = 0.75
"""A law of fewer parameters is taken first if it takes this share of what the best takes, and
leaves no more than `TWICE` its residual."""
OUTDONE = 0.5
"""Share that a law takes, at least, of what a smooth shape against the same quantity takes."""
PLAIN_SHAPES = ("speed and direction", "position", "angle within a turn",
                "acceleration, with the sign of the speed")
PHASE = 1.0
"""Half the interval of the phase of a wave in position, at most (rad)."""
MAX_TRIED = 12


@dataclass(frozen=True, kw_only=True)
class Look:
    """What every look for a law has in common."""

    blocks: Blocks
    """What is held out together."""
    hidden: frozenset[str]
    """Names that may not be used."""
    report: Callable[[str], None]
    """Takes a line for the person who waits."""
    smooth: list[GenericShape]
    """A law that takes less than half of what such a shape takes against the same quantity is not
    the law."""
    freest: np.ndarray
    """Regressors of the freest model, which say what a wave in time may be of the motion; shape
    (rows, k)."""
    plain_first: bool = True
    """Whether laws that filter the motion wait for those that do not."""


def choose(balance: InputBalance, look: Look) -> tuple[LawChoice | None, tuple[Trial, ...]]:
    """Return the law that a balance lacks, None where none is worth naming; and all trials."""
    blocks = look.blocks
    peaks = waves_in_time(balance.design.trajectory, balance.fit.residual, look.freest)
    looks = max((peak.looks for peak in peaks), default=1)
    candidates = candidate_terms(balance, look.hidden, [
        peak.order for peak in peaks if peak.order is not None and not peak.of_motion])
    if not candidates:
        return None, ()
    look.report(f"screening {len(candidates)} regressors")
    columns = [np.concatenate([balance.columns_of(term) for term in terms], axis=1)
               for _, terms in candidates]
    found = screen_by_sign_flips(columns, balance.free_columns, balance.fit.residual, blocks)
    before = balance.held_out(blocks)
    squares = blocks.sums(before**2)
    trials: list[Trial] = []
    lawful = np.array([_lawful(balance, terms, own)
                       for (_, terms), own in zip(candidates, found.coefficients)])
    size = rms(balance.design.trajectory.target)
    for index in _worth_trying(candidates, np.where(lawful, found.gain, -np.inf)):
        name, terms = candidates[index]
        p_value = float(found.family_p_value[index])
        if terms[-1].law.looked_for:
            p_value = min(1.0, p_value + (looks - 1) * float(found.p_value[index]))
        joined = balance
        for term in terms[:-1]:
            joined = joined.joined(term)
        last = refined(joined, terms[-1])
        joined = with_whole_delay(joined.joined(last))
        own = blocks.sums(joined.held_out(blocks) ** 2)
        taken = float((squares - own).sum())
        if taken > NEARLY_ALL * squares.sum() and not terms[-1].law.takes_of_all:
            p_value = min(p_value, p_of_much(
                np.concatenate([joined.columns_of(term) for term in (*terms[:-1], last)], axis=1),
                balance.free_columns, balance.fit.residual, joined.fit.residual, blocks,
                len(candidates)))
        trials.append(Trial(
            term=terms[0] if len(terms) > 1 else last, name=name,
            companion=last if len(terms) > 1 else None, p_value=p_value, squares=own,
            rows=len(before), gain=taken / float(squares.sum()),
            significant=bool(p_value <= (LEVEL_OF_MOST if taken > 0.5 * squares.sum()
                                         else LEVEL_OF_CHANCE)
                             and taken >= squares.sum() * (
                                 LEAST_OF_DYNAMIC if terms[-1].law.takes_of_all else LEAST_GAIN)
                             and taken >= LEAST_SIZE**2 * size**2 * len(before)
                             and taken > UNCERTAINTY * standard_error(squares - own)
                             and (joined.lawful or not balance.lawful)
                             and located(joined, blocks))))
    trials.sort(key=lambda trial: -trial.gain)
    good = [trial for trial in trials if trial.significant]
    if good:
        most = _taken_by_shapes(balance, look, float(squares.sum()))
        good = [trial for trial in good
                if trial.gain >= OUTDONE * most.get(trial.term.law.against, 0.0)]
    if not good:
        return None, tuple(trials)
    chosen = _simplest(good, {term.law.name for term in balance.terms}, look.plain_first)
    return LawChoice(
        trial=chosen, equivalent=equivalents(balance, blocks, chosen, good, squares),
        trials=tuple(trials), contested=good[0].term.law.dynamic and not chosen.term.law.dynamic,
    ), tuple(trials)


def _taken_by_shapes(balance: InputBalance, look: Look, squares: float) -> dict[str, float]:
    """Return the share of the held-out squares that smooth shapes take, by what they follow."""
    most: dict[str, float] = {}
    for shape in look.smooth:
        if shape.label in PLAIN_SHAPES:
            gain = 1.0 - balance.squares_beside(shape.columns, look.blocks) / squares
            most[shape.against] = max(gain, most.get(shape.against, 0.0))
    return most


def located(balance: InputBalance, blocks: Blocks, index: int = -1) -> bool:
    """Return whether the law of a term, by default the last, stands where the data say it is.

    A filter of the motion that stands anywhere takes a share of any friction; a wave of any phase
    follows from nothing, nor does one that only reversals show; a filter whose interval holds zero
    need not be there; a delay that may be below a sampling interval is one of the record; lost
    motion that lets go of friction alone is a build-up of friction of another shape.
    """
    law = balance.terms[index].law
    needed = {law.beside[name] for name in law.beside if name in balance.names}
    if not (law.dynamic or law.in_position or needed):
        return True
    found = {p.name.split(".")[1]: p for p in parameters(
        balance, index % len(balance.terms), blocks)}
    if law.in_position:
        return found["phase"].high - found["phase"].low <= 2.0 * PHASE \
            and wave_stands(balance, index % len(balance.terms))
    if law.name == "control_delay":
        return found["delay"].low > balance.design.trajectory.interval \
            or found["delay"].high < -balance.design.trajectory.interval
    needed |= set(law.coefficients) if law.dynamic else set()
    if any(found[name].low <= 0.0 <= found[name].high for name in needed):
        return False
    if not law.located:
        return True
    own = found[law.located]
    return own.high - own.low <= 2.0 * LOCATED * abs(own.value)


def _lawful(balance: InputBalance, terms: Sequence[Term], coefficients: np.ndarray) -> bool:
    """Return whether no coefficient breaks its sign; a change of a known term may."""
    at = 0
    for term in terms:
        own = coefficients[at:at + len(term.law.coefficients)]
        at += len(own)
        if term.law.positive and term.law.name not in balance.names and (own < 0.0).any():
            return False
    return True


def _worth_trying(candidates: list[Candidate], gain: np.ndarray) -> list[int]:
    """Return the best shape of each law, best first."""
    best: dict[tuple[str, str], int] = {}
    for index in np.argsort(-gain):
        name, terms = candidates[index]
        best.setdefault((name, terms[-1].law.name), int(index))
    return [index for index in best.values() if np.isfinite(gain[index])][:MAX_TRIED]


def _simplest(good: list[Trial], present: set[str], plain_first: bool) -> Trial:
    """Return the simplest law that takes nearly as much as the best; more comes in later steps.

    Another wave of a law that the model has is no new mechanism and counts as simplest. Laws
    that filter the motion wait while a plain one leaves no more than twice the residual, if
    `plain_first`.
    """
    plain = [trial for trial in good if not trial.term.law.dynamic]
    if plain_first and plain and plain[0].score <= TWICE * good[0].score:
        good = plain
    best = good[0]
    near = [trial for trial in good
            if trial.gain >= PARSIMONY * best.gain and trial.score <= TWICE * best.score]
    return min(near, key=lambda trial: (
        trial.name not in present, trial.complexity, -trial.gain))


LEAST_LOSS = 0.02
"""Share of the held-out squares by which they rise, at least, without a law that stays; and by
`LEAST_SIZE` of the input, as for one that is added."""


def least_loss(balance: InputBalance, squares: float) -> float:
    """Return by how much the held-out squares rise, at least, without a law that stays."""
    size = float(np.sum(balance.design.trajectory.target ** 2))
    return max(LEAST_LOSS * squares, LEAST_SIZE**2 * size)


def prune(balance: InputBalance, blocks: Blocks, protected: int) -> list[Term]:
    """Return the added terms that held-out blocks do not miss.

    Parameters
    ----------
    balance : with all that was added.
    blocks : what is held out together.
    protected : so many terms at the front are the model's own and stay.
    """
    dropped: list[Term] = []
    while len(balance.terms) > protected:
        squares = balance.squares(blocks)
        worst, least = None, least_loss(balance, squares)
        for index in range(protected, len(balance.terms)):
            if any(balance.terms[index].law.name in other.law.requires
                   for other in balance.terms):
                continue
            smaller = balance.without(index)
            loss = smaller.squares(blocks) - squares
            if loss < least:
                worst, least = index, loss
        if worst is None:
            break
        dropped.append(balance.terms[worst])
        balance = balance.without(worst)
    return dropped
