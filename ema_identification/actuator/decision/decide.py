"""The decision, whole: nothing, one law, two, a set of names, or something unknown.

1. *Nothing* unless the misfit, the largest useless gain or the gap, each in units of what the
   share `LEVEL` of healthy units exceeds, is surely rarer than `LEVEL` among them (rank among
   some that built nothing of the library, with the bound that holds for these very ones, Vovk
   2012), on its quadratic and again on runs; nor where that is so once the unit's numbers may
   leave their bands a little (`EDGE`), nor a law that gains little over such a unit.
2. Laws are proposed from the library (wide, cheap), fitted with the simulator (`ROUNDS`), and
   compared by one evidence: log E = -½ ν ln J - ½ k ln ν, J the cost, k coordinates, ν the
   independent numbers of a record. This is the likelihood of a scale that is not known, with the
   price of Schwarz (1978) on each coordinate.
3. A model *explains* if its cost is usual among healthy units; each law in it must have a gain
   of its own beyond the useless ones'. The answer is the smallest set of names with `SURE` of
   the evidence, the simplest model in it; more than `LARGEST_SET`, or no model that explains, is
   unknown.
4. What is named is measured anew, by runs over all that it may be (`intervals`).
5. Held-out records judge: names that do not lower their gap (`FALL`) are contradicted, and there
   is no silence where it is large: laws are tried then too. Where no model explains, a single law
   that closes most of misfit and gap (`MOST`) is named, and that something remains beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from ema_identification.actuator.decision.answer import (
    FleetAnswer,
    instead_of,
    log_evidence,
    stages_of,
)
from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.intervals import simulated_posterior
from ema_identification.actuator.decision.proposals import (
    LawProposal,
    alternating,
    gain_of,
    linear_gains,
    ripples,
    scores,
    scores_of,
    selectable,
    sized,
)
from ema_identification.actuator.decision.ranks import LEVEL, p_nothing, rank, share_of
from ema_identification.actuator.fleet.surrogate import SETTLED_RUNS
from ema_identification.actuator.laws.terms import SURE, LawFit, LawGap, moved
from ema_identification.actuator.measure.runs import Progress, silent
from ema_identification.result import after_validation

EDGE = 1.3
"""Requirement: half widths of its band up to which a number may be off and nothing is missing."""
LARGEST_SET = 3
"""Requirement: more names are no answer."""
MOST = 0.75
"""Requirement: share of the squares that a law closes beside which something remains, of the
misfit and of a held-out gap beyond its noise."""
SCREENED, PROPOSED, FEW = 16, 6, 3
"""Budget: laws fitted on the library; with the simulator; first laws that get a second, second
ones fitted beside each, pairs whose laws are each fitted alone."""
ROUNDS = ((SETTLED_RUNS // 4, 4, 4), (SETTLED_RUNS // 2, FEW, FEW))
"""Budget: runs, steps, and how many go on."""
FALL = 0.1
"""Budget: a fall of squares by less is none. Where no model explains the best take steps while
each lowers the cost by this share; names must lower a held-out gap beyond its noise by it."""


class LawJudge(Protocol):
    """Held-out records."""

    def gap(self, models: Sequence[LawFit], edge: float = 1.0) -> LawGap:
        """Return the gap of each model, the first without a law."""


def _settled(unit: TestedUnit, null: LawFit) -> LawFit:
    """Return the fit of no law on runs, from that on the quadratic."""
    first = unit.settled(null, null.mean, 3, salt=3)
    return unit.settled(first, null.mean, SETTLED_RUNS, salt=4)


class _Decision:
    def __init__(self, unit: TestedUnit, null: LawFit, without: Sequence[str]) -> None:
        self.unit, self.library = unit, unit.library
        self.quadratic, self.before = null, null.mean
        self.signatures = selectable(unit, without)
        self.without = tuple(without)
        self.null = _settled(unit, null)
        self.white = unit.whitener(SETTLED_RUNS, self.before)
        self.nothing = self.null.cost
        """What no law leaves at least, also beyond the bands."""

    def p_without(self) -> float:
        """Return `p_nothing` of the unit on runs."""
        again = linear_gains(self.unit, self.null, self.white, self.signatures)
        lower = again[0].cost if again else self.null.cost
        return p_nothing(scores_of(self.unit, self.null, lower), self.library.healthy)

    def explains(self, fit: LawFit) -> bool:
        """Whether a healthy unit leaves as much."""
        return rank(fit.cost / self.unit.size, self.library.healthy[:, 0]) > LEVEL

    def p_own(self, fit: LawFit, less: float) -> float:
        """Return how often the best useless law gains as much as from the cost `less`."""
        return rank(gain_of(less, fit.cost, self.unit.size), self.library.healthy[:, 1])

    def evidence(self, fit: LawFit) -> float:
        return log_evidence(fit, self.library.freedom)

    def fitted(self, starts: Sequence[LawFit]) -> list[LawFit]:
        """Return the models fitted with the simulator, most evidence first."""
        points = list(starts)
        for runs, steps, keep in ROUNDS:
            points = sorted((self.unit.descended(p, self.before, runs=runs, steps=steps)
                             for p in points), key=lambda f: -self.evidence(f))
            points = [p for p in points if np.isfinite(p.cost)][:keep]
        return sorted((self.unit.settled(p, self.before, SETTLED_RUNS) for p in points),
                      key=lambda f: -self.evidence(f))

    def finished(self, fits: Sequence[LawFit]) -> list[LawFit]:
        """Return the models, most evidence first; where none explains the best go on.

        The best single one and the best pair, all slopes simulated, from where they are, else from
        the middle of the fleet: beside a large law the library's quadratic leads to bounds.
        """
        found = sorted(fits, key=lambda f: -self.evidence(f))
        if any(self.explains(f) for f in found):
            return found
        for k in {len(f.terms): k for k, f in reversed(list(enumerate(found)))}.values():
            found[k] = self._further(found[k])
        return sorted(found, key=lambda f: -self.evidence(f))

    def _further(self, fit: LawFit) -> LawFit:
        near = min(fit, self._refitted(fit), key=lambda f: f.cost)
        return near if self.explains(near) else min(
            near, self._refitted(replace(fit, z=self.unit.centre)), key=lambda f: f.cost)

    def _refitted(self, fit: LawFit) -> LawFit:
        there = self.unit.refitted(fit, self.before, runs=ROUNDS[-1][0], fall=FALL)
        return self.unit.settled(there, self.before, SETTLED_RUNS)

    def measured(self, answer: FleetAnswer) -> FleetAnswer:
        """Return the answer with what runs tell of the model named: values and intervals.

        The values are those of the fit where runs there do not leave as little as healthy units.
        """
        if answer.fit is None:
            return answer
        fit, known = answer.fit, simulated_posterior(self.unit, answer.fit)
        terms, z = moved(fit.terms, known.mean[:fit.free]), known.mean[fit.free:]
        mean = self.unit.run(terms, z, SETTLED_RUNS, salt=8)
        there = replace(fit, terms=terms, z=z, mean=mean, cost=self.unit.cost(
            self.white, mean, z) if np.isfinite(mean).all() else np.inf)
        return replace(answer, known=known, fit=there if self.explains(there) else fit)

    def screened(self, proposals: Sequence[LawProposal], beside: LawFit | None) -> list[LawFit]:
        """Return the models of proposals, fitted without a run, lowest cost first."""
        terms, also = ((), self.quadratic.z) if beside is None else (beside.terms, beside.z)
        return sorted((self.unit.on_library((*terms, p.term), [p.z, also]) for p in proposals),
                      key=lambda f: f.cost)

    def singles(self) -> list[LawFit]:
        """Return the fits of single laws."""
        lists = (linear_gains(self.unit, self.null, self.white, self.signatures),
                 sized(self.unit, self.signatures),
                 ripples(self.unit, self.null, self.white, self.without))
        return self.fitted(self.screened(alternating(lists, SCREENED), None)[:PROPOSED])

    def pairs(self, singles: Sequence[LawFit]) -> list[LawFit]:
        """Return the fits of two laws.

        Where a single law explains: beside that one only, and where a second one gains more than
        useless ones do. Elsewhere the linear gain about a fit that is far off ranks second laws,
        but proves nothing, nor the contrary.
        """
        found: list[LawFit] = []
        alone = bool(singles) and self.explains(singles[0])
        for one in singles[:1 if alone else FEW]:
            more = linear_gains(self.unit, one, self.white, self.signatures)
            more += ripples(self.unit, one, self.white, (*self.without, *one.names))
            better = [p for p in sorted(more, key=lambda p: p.cost)
                      if p.signature.variant.effect not in one.names and not (
                          alone and rank(gain_of(one.cost, p.cost, self.unit.size),
                                         self.library.healthy[:, 1]) > LEVEL)]
            found += self.screened(alternating((better,), FEW), one)
        found.sort(key=lambda f: f.cost)
        return self.fitted(found[:PROPOSED]) if found else []

    def each_alone(self, pair: LawFit, fits: Sequence[LawFit]) -> list[LawFit]:
        """Return the best fits of each law of a pair alone, by law; `fits`: those there are.

        Where one of them explains too it is fitted as hard as can be before a second is named.
        """
        found = []
        ends = np.cumsum([t.variant.size for t in pair.terms])[:-1]
        parts = np.split(np.arange(pair.free), ends)
        for term, own in zip(pair.terms, parts):
            columns = np.append(own, np.arange(pair.free, pair.slopes.shape[1]))
            start = replace(pair, terms=(term,), slopes=pair.slopes[:, columns])
            known = [f for f in fits if f.names == (term.variant.effect,)]
            best = min([*self.fitted([start]), *known, replace(start, cost=np.inf)],
                       key=lambda f: f.cost)
            if self.explains(best):
                best = min(best, self._refitted(best), key=lambda f: f.cost)
            found.append(best)
        return found


def decide(
    unit: TestedUnit, held: LawJudge | None = None, *, witness: LawJudge | None = None,
    without: Sequence[str] = (), progress: Progress = silent,
) -> FleetAnswer:
    """Return the answer to a record.

    Parameters
    ----------
    unit : the record.
    held : held-out record of the same unit, if there is one.
    witness : one that only bears out a law beside which something remains, default `held`.
    without : effects that are not to be considered.
    progress : called with what is being done and how much of it is.
    """
    library, null = unit.library, unit.without_law()
    p = p_nothing(scores(unit, null, 0), library.healthy)
    usual = _usual(unit, null, p, held)
    if usual is not None and usual.verdict == "no disagreement":
        return usual
    progress("name", 0.1)
    case = _Decision(unit, null, without)
    p = max(p, case.p_without())
    usual = usual or _usual(unit, null, p, held)
    if usual is not None and usual.verdict == "no disagreement":
        return usual
    beyond = replace(unit, edge=EDGE * unit.edge)
    far = beyond.without_law()
    wide = _Decision(beyond, far, without)
    case.nothing = min(case.nothing, wide.null.cost)
    p_far = max(p_nothing(scores(beyond, far, 0), library.healthy), wide.p_without())
    usual = usual or _usual(beyond, far, p_far, held, EDGE)
    if usual is not None and usual.verdict == "no disagreement":
        return usual
    singles = case.singles()
    progress("name", 0.5)
    pairs = case.pairs(singles)
    progress("name", 0.9)
    fits = case.finished([*singles, *pairs])
    answer = FleetAnswer(verdict="unknown effect", null=case.null, p_nothing=p, fits=tuple(fits))
    answer = _named(case, answer, [f for f in fits if case.explains(f)])
    if usual is not None and answer.fit is None:
        return usual
    witness = witness or held
    if witness is not None and answer.verdict == "unknown effect" and not answer.equivalent:
        answer = _in_part(case, answer, witness)
    answer = case.measured(answer)
    return answer if held is None else _validated(answer, held)


def _usual(
    unit: TestedUnit, null: LawFit, p: float, held: LawJudge | None, edge: float = 1.0
) -> FleetAnswer | None:
    """Return silence where `p` is usual; unknown where the held-out record is off all the same.

    That is on the quadratic and again on runs. None where `p` is not usual.
    """
    if p <= LEVEL:
        return None
    where = f"numbers of the unit are up to {EDGE - 1.0:.0%} of their half band beyond it; "
    said = f"{where if edge > 1.0 else ''}of healthy units, up to {p:.2g} are as far off"
    answer = FleetAnswer(verdict="no disagreement", null=null, p_nothing=p, reasons=(said,))
    if held is None:
        return answer
    for fit in (lambda: null, lambda: _settled(unit, null)):
        gap = held.gap([fit()], edge)
        if share_of(int((gap.healthy >= gap.values[0]).sum()), len(gap.healthy)) > LEVEL:
            return replace(answer, gap=gap)
    return replace(answer, gap=gap, verdict="unknown effect", reasons=(
        said, f"the held-out record is off by {gap.values[0]:.3g}; healthy units by up to "
        f"{gap.bound:.3g} (95 %)"))


def _named(case: _Decision, answer: FleetAnswer, explaining: list[LawFit]) -> FleetAnswer:
    """Return the answer with the names that the evidence leaves."""
    tested: list[tuple[LawFit, tuple[float, ...], tuple[LawFit, ...]]] = [
        (fit, (case.p_own(fit, case.nothing),), (case.null,))
        for fit in explaining if len(fit.terms) == 1]
    best = max((case.evidence(f) for f, *_ in tested), default=-np.inf)
    for pair in [f for f in explaining if len(f.terms) == 2 and case.evidence(f) > best][:FEW]:
        less = tuple(case.each_alone(pair, answer.fits)[::-1])  # of each law, without it
        tested.append((pair, tuple(case.p_own(pair, f.cost) for f in less), less))
        tested += [(f, (case.p_own(f, case.nothing),), (case.null,))
                   for f in less if case.explains(f)]
    good = [row for row in tested if max(row[1]) <= LEVEL]
    if not good:
        why = "no law of the catalogue, nor two, leave what a healthy unit leaves"
        return replace(answer, reasons=(why,))
    weights: dict[frozenset[str], float] = {}
    top = max(case.evidence(row[0]) for row in good)
    for fit, *_ in good:
        key = frozenset(fit.names)
        weights[key] = max(weights.get(key, 0.0), float(np.exp(case.evidence(fit) - top)))
    ordered = sorted(weights, key=lambda k: -weights[k])
    share = np.cumsum([weights[k] for k in ordered]) / sum(weights.values())
    kept = ordered[:int(np.searchsorted(share, SURE)) + 1]
    chosen, p_value, less = min(  # a second law only where the evidence rules one alone out
        (row for row in good if frozenset(row[0].names) in kept),
        key=lambda row: (len(row[0].terms), -case.evidence(row[0])))
    equivalent = tuple(instead_of(chosen, name, kept) for name in chosen.names)
    if max(len(e) for e in equivalent) >= LARGEST_SET:
        return replace(answer, equivalent=(tuple(sorted(set().union(*kept))),), reasons=(
            f"{len(kept)} explanations are equally good",))
    excess = max(case.null.cost - chosen.cost, 1e-9)
    closed = tuple(float(np.clip((f.cost - chosen.cost) / excess, 0.0, 1.0)) for f in less)
    return replace(answer, verdict="explained", fit=chosen, equivalent=equivalent,
                   p_value=p_value, closed=closed,
                   alone=less[::-1] if len(less) > 1 else ())


def _in_part(case: _Decision, answer: FleetAnswer, held: LawJudge) -> FleetAnswer:
    """Return the answer with the law, or the set, that closes most of misfit and held-out gap."""
    singles = [f for f in answer.fits if len(f.terms) == 1 and np.isfinite(f.cost)]
    usual = float(np.median(case.library.healthy[:, 0])) * case.unit.size
    if not singles:
        return answer
    best = singles[0]
    closed = (case.null.cost - best.cost) / max(case.null.cost - usual, 1e-9)
    p = case.p_own(best, case.nothing)
    if closed < MOST or p > LEVEL:
        return answer
    sure = case.evidence(best) + np.log(1.0 - SURE)
    names = {f.names[0] for f in singles if case.evidence(f) > sure} - set(best.names)
    gap = held.gap([case.null, best])
    if len(names) >= LARGEST_SET or not gap.closes(MOST):
        return answer
    return replace(
        answer, verdict="partly explained", fit=best, equivalent=(tuple(sorted(names)),),
        p_value=(p,), closed=(float(closed),), reasons=(
            "beside it something remains that no law of the catalogue explains",))


def _validated(answer: FleetAnswer, held: LawJudge) -> FleetAnswer:
    """Return the answer as held-out records leave it."""
    gap = held.gap(stages_of(answer))
    verdict, said = after_validation(
        answer.verdict, gap.values[0], gap.values[-1], gap.bound, "healthy units", least=FALL)
    return replace(answer, gap=gap, verdict=verdict, reasons=(*said, *answer.reasons))
