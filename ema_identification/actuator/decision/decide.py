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
5. Held-out records only judge: what makes their gap grow is contradicted (`after_validation`),
   and there is no silence where it is large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from scipy.special import betaincinv

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
    gain_of,
    linear_gains,
    ripples,
    scores,
    scores_of,
    selectable,
    sized,
)
from ema_identification.actuator.fleet.surrogate import SETTLED_RUNS
from ema_identification.actuator.laws.terms import SURE, LawFit, LawGap, moved
from ema_identification.actuator.measure.runs import Progress, silent
from ema_identification.result import after_validation

LEVEL = 0.01
"""Requirement: names on nothing, at most 1 %. Of every test."""
EDGE = 1.3
"""Requirement: half widths of its band up to which a number may be off and nothing is missing."""
LARGEST_SET = 3
"""Requirement: more names are no answer."""
SCREENED, PROPOSED, FEW = 16, 6, 3
"""Budget: laws fitted on the library; with the simulator; first laws that get a second, second
ones fitted beside each, pairs whose laws are each fitted alone."""
ROUNDS = ((SETTLED_RUNS // 4, 4, 4), (SETTLED_RUNS // 2, FEW, FEW))
"""Budget: runs, steps, and how many go on."""
FALL = 0.1
"""Budget: where none explains the best models take steps while each lowers the cost by this
share: one that is still on its way is not judged."""


class LawJudge(Protocol):
    """Held-out records."""

    def gap(self, models: Sequence[LawFit], edge: float = 1.0) -> LawGap:
        """Return the gap of each model, the first without a law."""


def rank(score: float, healthy: np.ndarray) -> float:
    """Return the probability of a score as large among units that are exchangeable."""
    return float(1.0 + (healthy >= score).sum()) / (1.0 + len(healthy))


def p_nothing(score: Sequence[float], healthy: np.ndarray) -> float:
    """Return the share of healthy units that are as far off, with `SURE` at most as large.

    Cost, gain and gap count in units of what the share `LEVEL` of the units exceeds in each, and
    the largest of the three is ranked: having looked at all is paid for, and one that is far
    beyond all healthy units is enough, the others being usual. (The rarest of three ranks never
    is: the farthest healthy unit in each of the three is as rare.) Of `n` healthy units `k` are
    as far off: the bound of Clopper and Pearson (1934). Among all libraries that might have been
    drawn, at least `SURE` keep what it promises.
    """
    pooled = np.vstack([score, healthy])
    farthest = (pooled / np.quantile(pooled, 1.0 - LEVEL, axis=0)).max(axis=1)
    return share_of(int((farthest[1:] >= farthest[0]).sum()), len(healthy))


def share_of(as_rare: int, units: int) -> float:
    """Return the largest share that is compatible, with `SURE`, with so many of `units`."""
    return float(betaincinv(as_rare + 1, units - as_rare, SURE)) if as_rare < units else 1.0


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
        return self.fitted(self.screened(_alternating(lists, SCREENED), None)[:PROPOSED])

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
            found += self.screened(_alternating((better,), FEW), one)
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


def _alternating(lists: Sequence[Sequence[LawProposal]], most: int) -> list[LawProposal]:
    """Return the first of each list in turn, at most two variants of one effect."""
    found: list[LawProposal] = []
    names: dict[str, int] = {}
    seen = set()
    for row in range(max((len(x) for x in lists), default=0)):
        for proposals in lists:
            if row >= len(proposals) or len(found) >= most:
                continue
            p = proposals[row]
            key = p.signature.variant.name
            if key in seen or names.get(p.signature.variant.effect, 0) >= 2 or not np.any(p.u):
                continue
            seen.add(key)
            names[p.signature.variant.effect] = names.get(p.signature.variant.effect, 0) + 1
            found.append(p)
    return found


def decide(
    unit: TestedUnit, held: LawJudge | None = None, *, without: Sequence[str] = (),
    progress: Progress = silent,
) -> FleetAnswer:
    """Return the answer to a record.

    Parameters
    ----------
    unit : the record.
    held : held-out record of the same unit, if there is one.
    without : effects that are not to be considered.
    progress : called with what is being done and how much of it is.
    """
    library, null = unit.library, unit.without_law()
    p = p_nothing(scores(unit, null, 0), library.healthy)
    if p > LEVEL:
        return _nothing(unit, null, p, held)
    progress("name", 0.1)
    case = _Decision(unit, null, without)
    p = max(p, case.p_without())
    if p > LEVEL:
        return _nothing(unit, null, p, held)
    beyond = replace(unit, edge=EDGE)
    far = beyond.without_law()
    wide = _Decision(beyond, far, without)
    case.nothing = min(case.nothing, wide.null.cost)
    p_far = max(p_nothing(scores(beyond, far, 0), library.healthy), wide.p_without())
    if p_far > LEVEL:
        return _nothing(beyond, far, p_far, held)
    singles = case.singles()
    progress("name", 0.5)
    pairs = case.pairs(singles)
    progress("name", 0.9)
    fits = case.finished([*singles, *pairs])
    answer = FleetAnswer(verdict="unknown effect", null=case.null, p_nothing=p, fits=tuple(fits))
    answer = case.measured(_named(case, answer, [f for f in fits if case.explains(f)]))
    return answer if held is None else _validated(answer, held)


def _nothing(unit: TestedUnit, null: LawFit, p: float, held: LawJudge | None) -> FleetAnswer:
    """Return silence, unless the held-out record is off on the quadratic and again on runs."""
    where = f"numbers of the unit are up to {EDGE - 1.0:.0%} of their half band beyond it; "
    said = f"{where if unit.edge > 1.0 else ''}of healthy units, up to {p:.2g} are as far off"
    answer = FleetAnswer(verdict="no disagreement", null=null, p_nothing=p, reasons=(said,))
    if held is None:
        return answer
    for fit in (lambda: null, lambda: _settled(unit, null)):
        gap = held.gap([fit()], unit.edge)
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


def _validated(answer: FleetAnswer, held: LawJudge) -> FleetAnswer:
    """Return the answer as held-out records leave it: they only judge."""
    gap = held.gap(stages_of(answer))
    verdict, said = after_validation(
        answer.verdict, gap.values[0], gap.values[-1], gap.bound, "healthy units")
    return replace(answer, gap=gap, verdict=verdict, reasons=(*said, *answer.reasons))
