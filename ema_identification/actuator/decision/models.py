"""Models of one record: proposed from the library, fitted with the simulator, compared."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ema_identification.actuator.decision.answer import log_evidence
from ema_identification.actuator.decision.fit import FALL, TestedUnit
from ema_identification.actuator.decision.intervals import (
    INTERVAL_ROUNDS,
    at,
    linearised,
    measured,
)
from ema_identification.actuator.decision.proposals import (
    LawProposal,
    alternating,
    at_known_sizes,
    gain_of,
    linear_gains,
    ripples,
    scores_of,
    selectable,
    sized,
)
from ema_identification.actuator.decision.ranks import LEVEL, p_nothing, rank
from ema_identification.actuator.fleet.surrogate import SETTLED_RUNS, excess
from ema_identification.actuator.laws.terms import LawFit, Posterior, library_slopes

LARGEST_SET = 3
"""Requirement: more names are no answer. So as many of anything go on: models from one round of
fits to the next (the best one from two starts), first laws that get a second, second laws of each,
pairs that are fitted as hard as can be, pairs whose laws are each fitted alone."""
PROPOSED, SCREENED = 2 * LARGEST_SET, 4 * LARGEST_SET
"""Laws fitted with the simulator; on the library, of which half are left; pairs begun so."""
ROUNDS = SETTLED_RUNS // 4, SETTLED_RUNS // 2
"""Runs of a model in each round, of `LARGEST_SET` steps."""


def noisy(unit: TestedUnit, fit: LawFit) -> TestedUnit:
    """Return a unit with the noise of a model's runs if the others leave too much of one."""
    rows = np.array(unit.run_all([(fit.terms, fit.z)] * SETTLED_RUNS, 1, 17, apart=True))
    rows = rows[np.isfinite(rows).all(axis=1)]
    rest = (rows - rows.sum(axis=0) / max(len(rows), 1)).T * len(rows) / max(len(rows) - 1, 1)
    left = (unit.whitener(SETTLED_RUNS - 1).residual(rest) ** 2).sum(axis=0) / unit.size
    if all(rank(float(cost), unit.library.healthy[:, 0]) > LEVEL for cost in left):
        return unit
    return replace(unit, scatter=excess(rows, np.diag(unit.noise())))


class Models:
    """Fits of a record, of no law, one and two."""

    def __init__(self, unit: TestedUnit, without: Sequence[str] = ()) -> None:
        self.unit, self.library = unit, unit.library
        self.signatures, self.without = selectable(unit, without), tuple(without)
        self.quadratic = unit.without_law()
        self.before = self.quadratic.mean
        first = unit.settled(self.quadratic, self.before, 3, salt=3)
        self.null = unit.settled(first, self.before, SETTLED_RUNS, salt=4)
        self.white = unit.whitener(SETTLED_RUNS, self.before)
        self.nothing = self.null.cost
        """What no law leaves at least, also beyond the bands."""
        self._hard: list[LawFit] = []  # that have been pressed
        self._measured: list[tuple[LawFit, Posterior, LawFit]] = []  # see `remeasured`

    def p_without(self) -> float:
        """Return `p_nothing` of the unit on runs."""
        gains = linear_gains(self.unit, self.null, self.white, self.signatures)
        return p_nothing(scores_of(self.unit, self.null, gains), self.library.healthy)

    def explains(self, fit: LawFit) -> bool:
        """Whether a healthy unit leaves as much."""
        return rank(fit.cost / self.unit.size, self.library.healthy[:, 0]) > LEVEL

    def p_own(self, fit: LawFit | LawProposal, less: float) -> float:
        """Return how often the best useless law gains as much as from the cost `less`."""
        return rank(gain_of(less, fit.cost, self.unit.size), self.library.healthy[:, 1])

    def evidence(self, fit: LawFit) -> float:
        """Return `log_evidence`."""
        return log_evidence(fit, self.library)

    def fitted(self, starts: Sequence[LawFit]) -> list[LawFit]:
        """Return the models fitted, most evidence first; once one explains, only such go on."""
        points, others = list(starts), list[LawFit]()
        for runs in ROUNDS:
            points = self._ordered(self.unit.descended(
                p, self.before, runs=runs, steps=LARGEST_SET) for p in points)
            alike: dict[tuple[str, ...], list[LawFit]] = {}
            for p in [p for p in points if np.isfinite(p.cost)]:
                alike.setdefault(p.variants, []).append(p)
            kept = list(alike.values())[:LARGEST_SET]
            if good := [group for group in kept if self.explains(group[0])]:
                others += [group[0] for group in kept if not self.explains(group[0])]
                kept = good
            points = [p for k, group in enumerate(kept) for p in group[:1 if k else 2]]
        return self._ordered([*(self.unit.settled(
            group[0], self.before, SETTLED_RUNS) for group in kept), *others])

    def _ordered(self, fits: Iterable[LawFit]) -> list[LawFit]:
        return sorted(fits, key=lambda f: -self.evidence(f))

    def finished(self, fits: Sequence[LawFit]) -> list[LawFit]:
        """Return the models, most evidence first.

        Where none explains each law of the best pair gets another, and the best pairs go on that
        leave less than each single law.
        """
        found = self._ordered(fits)
        if not any(map(self.explains, found)):
            found = self._ordered([*found, *self.exchanged(found)])
        if not any(map(self.explains, found)):
            one = min([f.cost for f in found if len(f.terms) == 1], default=np.inf)
            for k in [k for k, f in enumerate(found) if f.cost < one][:LARGEST_SET]:
                found[k] = self._pressed(found[k])
        return self._ordered(found)

    def _pressed(self, fit: LawFit) -> LawFit:
        """Return a fit that has gone on until it explains or stands still, all slopes simulated.

        From where it is, then from where rounds of runs over all that it may be lead: what goes
        to and fro with a number has no slope over them, so that the rest shows the way first.
        """
        if any(fit is f for f in self._hard):
            return fit
        found = min(fit, self.refitted(fit), key=lambda f: f.cost)
        if not self.explains(found):
            ends: list[LawFit] = []
            for k, (known, points, features, _) in enumerate(
                    linearised(self.unit, found), 1):
                left = [self.unit.cost(self.white, f, x[found.free:])
                        for x, f in zip(points, features)]
                led = [self.unit.begun(at(found, x), self.white, ROUNDS[-1])
                       for x in (known.mean, points[np.argmin(left)])]
                last = min([f.cost for f in ends], default=np.inf)
                ends = [led[0], min([*ends, *led], key=lambda f: f.cost)]
                if k >= INTERVAL_ROUNDS and not ends[-1].cost < (1.0 - FALL) * last:
                    break
            found = min([found, *map(self.refitted, ends)], key=lambda f: f.cost)
        self._hard.append(found)
        return found

    def refitted(self, fit: LawFit) -> LawFit:
        """Return a fit gone on from there with all slopes simulated."""
        there = self.unit.refitted(fit, self.before, runs=ROUNDS[-1])
        return self.unit.settled(there, self.before, SETTLED_RUNS)

    def remeasured(self, fit: LawFit) -> tuple[Posterior, LawFit]:
        """Return what runs over all that a model may be tell of it, and what leaves least there.

        Of the fit, of where the runs lead, of a linear step from that, and, where the fit leaves
        more than half of the healthy units do, of where it goes on to with all slopes simulated.
        """
        for of, known, found in self._measured:
            if of is fit:
                return known, found
        known, slopes = measured(self.unit, fit)
        points = [self.unit.begun(f, self.white, SETTLED_RUNS) for f in (fit, at(fit, known.mean))]
        if np.isfinite(points[1].cost):
            step = self.unit.settled_at(points[1], points[1].mean, self.white, SETTLED_RUNS)
            points.append(self.unit.begun(step, self.white, SETTLED_RUNS))
        if fit.cost > self.usual:
            points.append(self.unit.begun(self.refitted(fit), self.white, SETTLED_RUNS))
        found = min([p for p in points if np.isfinite(p.cost)], key=lambda f: f.cost, default=fit)
        if found is not fit:
            found = replace(found, slopes=slopes)
        self._measured.append((fit, known, found))
        return known, found

    @property
    def usual(self) -> float:
        """Return the cost that half of the healthy units leave at most."""
        return float(np.median(self.library.healthy[:, 0])) * self.unit.size

    def singles(self) -> list[LawFit]:
        """Return the fits of single laws.

        Where none explains the best, and the best on the library, are fitted as hard as can be:
        second laws are sought beside them.
        """
        gains = linear_gains(self.unit, self.null, self.white, self.signatures)
        lists = (gains, sized(self.unit, self.signatures),
                 ripples(self.unit, self.null, self.white, self.without))
        starts = sorted((self.unit.on_library((p.term,), [p.z, self.quadratic.z])
                         for p in alternating(lists, SCREENED)), key=lambda f: f.cost)
        found = self.fitted([*starts[:PROPOSED], *self.beside(
            self.null, at_known_sizes(gains[:1]))])
        if not found or self.explains(found[0]):
            return self.compared(found)
        found[0] = self._pressed(found[0])
        if not self.explains(found[0]) and starts[0].names != found[0].names:
            hard = self._pressed(self.unit.begun(starts[0], self.white, SETTLED_RUNS))
            found = [f for f in found if f.variants != hard.variants or f.cost < hard.cost]
            found.append(hard)
        return self._ordered(found)

    def compared(self, fits: Sequence[LawFit]) -> list[LawFit]:
        """Return the fits, the next also begun at the best one's numbers, variants of it once."""
        best, found = None, self._ordered(fits)
        for k in range(LARGEST_SET):
            if not found or found[0] is best:
                break
            best, *rest = found
            rivals = [f if k and f.names == best.names else self._also_beside(f, best)
                      for f in rest[:LARGEST_SET]]
            if any(end is not f for end, f in zip(rivals, rest)):
                best = min(best, self.refitted(best), key=lambda f: f.cost)
            found = self._ordered([best, *rivals, *rest[LARGEST_SET:]])
        return found

    def _also_beside(self, fit: LawFit, best: LawFit) -> LawFit:
        """Return a fit gone on from there and from another's numbers, where it explains."""
        starts = [fit, replace(fit, z=best.z)]
        if not self.explains(fit):
            there = self.unit.descended(starts[1], self.before, runs=ROUNDS[-1], steps=LARGEST_SET)
            starts = [there] if self.explains(there) else []
        return min([fit, *map(self.refitted, starts)], key=lambda f: f.cost)

    def beside(self, fit: LawFit, proposals: Sequence[LawProposal]) -> list[LawFit]:
        """Return a fit with each law added at its size, all else as it is."""
        return [replace(fit, terms=(*fit.terms, p.term), cost=np.inf, slopes=np.insert(
                    fit.slopes, [fit.free], library_slopes((p.term,)), axis=1))
                for p in proposals]

    def hardest(self, fits: Sequence[LawFit]) -> LawFit:
        """Return the fit of no law, as hard as any other, also from where `fits` are."""
        starts = [replace(f, terms=(), slopes=f.slopes[:, f.free:]) for f in fits]
        found = [one for start in (self.null, *starts) for one in self.fitted([start])]
        found.append(self.refitted(min(found, key=lambda f: f.cost)))
        return min(self.null, *found, key=lambda f: f.cost)

    def gains(self, fit: LawFit) -> list[LawProposal]:
        """Return what each law, or ripple, that a fit has not would gain beside it, best first."""
        found = linear_gains(self.unit, fit, self.white, self.signatures)
        found += ripples(self.unit, fit, self.white, (*self.without, *fit.names))
        return sorted((p for p in found if p.signature.variant.effect not in fit.names),
                      key=lambda p: p.cost)

    def adds(self, fit: LawFit, nothing: LawFit) -> bool:
        """Whether a model gains more than useless laws do over the `hardest` fit of none.

        It is fitted as hard, also from there.
        """
        starts = fit, replace(fit, z=nothing.z)
        hard = min([fit, *map(self.refitted, starts)], key=lambda f: f.cost)
        return self.p_own(hard, min(nothing.cost, self.nothing)) <= LEVEL

    def needs(self, fit: LawFit, sizes: Sequence[float], alone: Sequence[LawFit]) -> bool:
        """Whether each law is told from none: by its `p_sizes`, or no fit without it explains.

        `alone` : of two laws, the fit of each without the other; fitted as hard as can be.
        """
        for k, p in enumerate(sizes):
            if p > LEVEL:
                less = self._pressed(alone[1 - k]) if alone else self.hardest([fit])
                if self.explains(less) or not np.isfinite(less.cost):
                    return False
        return True

    def pairs(self, singles: Sequence[LawFit]) -> list[LawFit]:
        """Return the fits of two laws.

        Where a single law explains: beside that one only, once it is measured, and where a second
        one gains more than useless ones do, there or before. Elsewhere the linear gain about a fit
        that is far off ranks second laws, but proves nothing, nor the contrary.
        """
        starts: list[LawFit] = []
        alone = bool(singles) and self.explains(singles[0])
        firsts = [self.remeasured(singles[0])[1]] if alone else singles[:LARGEST_SET]
        for one in firsts:
            gains = [[p for p in self.gains(f) if not (alone and self.p_own(p, f.cost) > LEVEL)]
                     for f in ((one, singles[0]) if alone else (one,))]
            better = alternating(gains, LARGEST_SET)
            for z in one.z, self.unit.centre:  # numbers that make up for a law may hide it
                starts += self.beside(replace(one, z=z), [*better, *at_known_sizes(better[:1])])
        begun = (self.unit.begun(start, self.white, ROUNDS[0]) for start in starts)
        return self.fitted(sorted(begun, key=lambda f: f.cost)[:SCREENED])

    def exchanged(self, fits: Sequence[LawFit]) -> list[LawFit]:
        """Return fits of each law of the best pair with another beside it, where that is new."""
        firsts = [f.names for f in fits if len(f.terms) == 1][:LARGEST_SET]
        pairs = [f for f in fits if len(f.terms) == 2][:1]
        return [f for pair in pairs for start in pair.alone() if start.names not in firsts
                for one in self.fitted([start]) for f in self.pairs([one])]

    def each_alone(self, pair: LawFit, fits: Sequence[LawFit]) -> list[LawFit]:
        """Return the best fits of each law of a pair alone, by law; `fits`: those there are.

        The better one is fitted as hard as can be before a second is named.
        """
        fits = [*fits, *(found for *_, found in self._measured)]
        found = [min([*self.fitted([start]), *(f for f in fits if f.names == start.names), start],
                     key=lambda f: f.cost) for start in pair.alone()]
        best = int(np.argmin([f.cost for f in found]))
        found[best] = self._pressed(found[best])
        return found
