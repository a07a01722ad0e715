"""The contest: candidates are fitted further and further, the hopeless ones left behind."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.measure.runs import Progress, silent
from ema_identification.actuator.naming.ensemble_search import approached, compass
from ema_identification.actuator.naming.optimiser import descend, finished
from ema_identification.actuator.surrogate.evidence import Asked, Evidence
from ema_identification.actuator.surrogate.fit import (
    Fit,
    Point,
    Start,
    run_point,
    run_points,
)
from ema_identification.actuator.surrogate.likelihood import Recalibration, Robust, reference

LAST_SHARE = 0.1
"""Of the cost by which candidates are compared in the end."""


class Round(NamedTuple):
    """One round of the contest."""

    share: float
    """Of a residual that is granted as its error: much at first, lest few features decide."""
    runs: int
    steps: int
    keep: int
    """Most candidates that go on."""
    behind: float
    """A candidate whose cost is so many times the best one's does not go on."""
    worth: float
    """Fall of the cost that is worth a step, in units of the cost a feature."""


ROUNDS = (
    Round(0.3, 2, 3, 4, 2.0, 20.0),
    Round(0.15, 3, 3, 3, 2.0, 5.0),
    Round(LAST_SHARE, 3, 4, 3, 2.0, 1.0),
)
FINAL_RUNS = 10
REPEATS = 6
"""Runs of a fitted model that tell its scatter."""
POLISH, WORTH = 4, 0.05
"""Most times that a fit goes on where it stopped, and what it must gain by that."""
AROUND = 3
"""Most times that is looked around a fit that is not complete, as long as that helps."""
THOROUGH = 1.4
"""Cost from which slopes to the tolerances are simulated, in units of a complete model's."""
NEAR_BEST = 2.0
"""The same, in units of the cost of the best candidate."""
MOST_VARIANTS = 2
"""Of one effect that go on."""


class Arena:
    """What all fits of one unit have in common: the metrics, and the cost without an effect."""

    def __init__(self, evidence: Evidence, null: Recalibration, *, seed: int = 0) -> None:
        before = reference(evidence, null.mean, null.cost)
        self.evidence, self.seed = evidence, seed
        self.metrics = tuple(
            Robust(before=tuple(before), runs=s.runs, share=s.share) for s in ROUNDS)
        self.last = Robust(before=tuple(before), runs=FINAL_RUNS, share=LAST_SHARE)
        self.null_cost = self.last.cost(evidence, null.predicted(evidence), null.z)

    def fits(
        self, starts: Sequence[Start], *, progress: Progress = silent, span: tuple[float, float] =
        (0.0, 1.0), first: int = 0,
    ) -> list[Fit]:
        """Return a fit of every candidate, best first.

        Those left behind end with the same fresh runs and the same last step as the others.
        """
        points = self._first(starts)
        left: list[Point] = []
        for k, (stage, rule) in enumerate(zip(ROUNDS, self.metrics)):
            if k < first:
                continue
            costs = []
            last = [self.last.cost(self.evidence, p.mean, p.z) for p in points] if (
                k == len(ROUNDS) - 1) else []
            for i, point in enumerate(points):
                points[i] = descend(
                    self.evidence, rule, point, steps=stage.steps, seed=self.seed,
                    worth=stage.worth, thorough=bool(last) and THOROUGH * self.evidence.usual
                    < last[i] < NEAR_BEST * min(last))
                costs.append(rule.cost(self.evidence, points[i].mean, points[i].z))
                share = (k + (i + 1) / len(points)) / len(ROUNDS)
                progress("name", span[0] + share * (span[1] - span[0]))
            order = np.argsort(costs)
            kept = _kept([(costs[i], points[i]) for i in order], stage)
            kept = [int(order[j]) for j in kept]
            left += [points[i] for i in order if i not in kept]
            points = [points[i] for i in kept]
        found = [finished(self.evidence, self.last, p, seed=self.seed + 50, runs=FINAL_RUNS)
                 for p in (*points, *left)]
        found[len(points):] = [replace(f, left_behind=True) for f in found[len(points):]]
        return sorted((f for f in found if np.isfinite(f.cost)), key=lambda f: f.cost)

    def scattering(self, fit: Fit) -> Robust:
        """Return the last metric with what runs of a fitted model differ by among themselves.

        A large effect makes limit cycles that repeat less well than an effect-free unit's.
        """
        evidence = self.evidence
        effects = fit.effects(evidence.blocks[0].library.model.effects)
        runs = evidence.means([Asked(fit.z, effects, 1, self.seed + 90 + k)
                               for k in range(REPEATS)])
        whole = [r for r in runs if all(np.isfinite(f).all() for f in r)]
        if len(whole) < 2:
            return self.last
        return replace(self.last, scatter=tuple(
            np.std(parts, axis=0, ddof=1) for parts in zip(*whole)))

    def polished(self, fit: Fit) -> Fit:
        """Return a fit that went on from another as long as that helped."""
        for _ in range(POLISH):
            again = self.fits([Start(fit.terms, fit.z)], first=1)
            if not again or again[0].cost > (1.0 - WORTH) * fit.cost:
                return min([fit, *again], key=lambda f: f.cost)
            fit = again[0]
        return fit

    def refined(self, fit: Fit) -> Fit:
        """Return a fit that is looked for around another that is not complete.

        The tolerances may be far off, since an effect that was missing moved them; they begin
        half way to nominal.
        """
        terms, z = approached(self.evidence, self.last, fit.terms, 0.5 * fit.z,
                              seed=self.seed + 30)
        best = fit
        for _ in range(AROUND):
            point = run_point(self.evidence, terms, z, runs=self.metrics[-1].runs, seed=self.seed)
            if not point.finite:
                break
            point = compass(self.evidence, self.metrics[-1], point, seed=self.seed)
            found = self.fits([Start(point.terms, point.z)], first=len(ROUNDS) - 1)
            if not found:
                break
            better = found[0].cost < (1.0 - WORTH) * best.cost
            best = min(best, found[0], key=lambda f: f.cost)
            if best.cost < self.evidence.usual * THOROUGH or not better:
                break
            terms, z = found[0].terms, found[0].z
        return best

    def _first(self, starts: Sequence[Start]) -> list[Point]:
        points = run_points(
            self.evidence, [(s.terms, np.clip(s.z, -1.0, 1.0)) for s in starts],
            runs=ROUNDS[0].runs, seed=self.seed)
        return [p for p in points if p.finite]


def _kept(ranked: Sequence[tuple[float, Point]], stage: Round) -> list[int]:
    """Return the places of those that go on: near the best, each set of effects once or twice."""
    found: list[int] = []
    count: Counter[tuple[str, ...]] = Counter()
    for place, (cost, point) in enumerate(ranked):
        names = tuple(sorted(t.variant.effect for t in point.terms))
        if cost < stage.behind * ranked[0][0] and count[names] < MOST_VARIANTS:
            count[names] += 1
            found.append(place)
    return found[:stage.keep]
