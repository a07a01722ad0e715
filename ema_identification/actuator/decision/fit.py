"""One record against the healthy fleet: its likelihood, and fits of none, one or two laws.

A model is judged by the cost

    J = |C^-1/2 b((y - f) / s)|² + sum w_j (z_j - c_j)²,   |z_j| <= edge,

y the features, f the prediction, s and C deviations and correlation of their noise as measured
(`surrogate.NoiseLaw`), b a logarithm beyond five deviations, z all in which healthy units differ,
of a unit of which nothing else is known w = 3, the inverse variance of an even number, and c = 0.
First f is the quadratic of the library; then the mean of runs at the point reached.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np
from scipy.linalg import cholesky

from ema_identification.actuator.decision.slopes import (
    bounded_least_squares,
    law_slopes,
    simulated_slopes,
)
from ema_identification.actuator.fleet.surrogate import FleetLibrary, Whitener, least_size, mended
from ema_identification.actuator.fleet.units import fleet_features
from ema_identification.actuator.laws.terms import (
    EffectTerm,
    LawFit,
    bounds,
    coordinates,
    law_sizes,
    library_slopes,
    moved,
    with_terms,
)
from ema_identification.actuator.measure.tolerances import RecordConditions, conditions_of
from ema_record.record import Record
from ema_sim.effects import Effects

PRIOR = 3.0
"""1 / variance of a number that is uniform from -1 to 1."""
LAW_ERROR = 0.02
"""Relative error of what a simulated law adds (steps of the solver, end of the descent)."""
QUADRATIC_STEPS, DAMPINGS, STEP_DAMPINGS = 20, 4, (0.0, 0.03, 0.3, 3.0)
"""Most steps of a descent without runs, dampings tried a step; those tried on runs."""
FALL = 0.1
"""A descent that lowers the cost by less stands still."""
_threads = cache(ThreadPoolExecutor)
"""Threads, which live on, each with its room; two work nearly as two processes."""


@dataclass(frozen=True, kw_only=True)
class TestedUnit:
    """A record, what is known of its like, and runs of models of it.

    Attributes
    ----------
    library, conditions : of its test; as measured.
    values : ndarray, shape (d,). Its features.
    seed, workers : of all runs; threads that share them.
    centre, weight : ndarrays, shape (width,). Where the unit is expected, and how surely.
    simulator : gives the features of a run; its arguments are those of `fleet_features`.
    record : itself, for pictures.
    edge : half widths of its band that a number may be off, 1 by the description; of each or all.
    scatter : ndarray, shape (d,) or (1,). Variance of the features beyond that of a healthy unit.
    """

    library: FleetLibrary
    values: np.ndarray
    conditions: RecordConditions
    seed: int = 0
    workers: int = 1
    centre: np.ndarray = field(default_factory=partial(np.zeros, 0))
    weight: np.ndarray = field(default_factory=partial(np.zeros, 0))
    simulator: Callable[..., np.ndarray] = fleet_features
    record: Record | None = None
    edge: float | np.ndarray = 1.0
    scatter: np.ndarray = field(default_factory=partial(np.zeros, 1))
    _whiteners: dict[tuple[int, bytes], Whitener] = field(
        init=False, repr=False, compare=False, default_factory=dict)
    _runs: dict[tuple[Effects, bytes, int], np.ndarray] = field(
        init=False, repr=False, compare=False, default_factory=dict)

    def __post_init__(self) -> None:
        if not len(self.centre):  # nothing else is known of the unit
            object.__setattr__(self, "centre", np.zeros(self.library.width))
            object.__setattr__(self, "weight", np.full(self.library.width, PRIOR))

    @property
    def size(self) -> int:
        """Number of features."""
        return len(self.values)

    @property
    def parts(self) -> tuple[TestedUnit, ...]:
        """Return the single records, one unless they are judged together."""
        return (self,)

    @property
    def places(self) -> Sequence[np.ndarray]:
        """Return where the numbers of each record stand in `z`."""
        return [np.arange(len(self.centre))]

    @property
    def day(self) -> np.ndarray:
        """Return which numbers belong to the day of a test, shape (width,), bool."""
        return self.library.of_day

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        """Return features, shape (..., d), record by record."""
        return np.split(values, np.cumsum([p.size for p in self.parts])[:-1], axis=-1)

    def set_aside(self) -> list[TestedUnit | None]:
        """Return the healthy units that built nothing, in their order; None where a run failed."""
        return units_aside(self.library)

    def noise(self) -> np.ndarray:
        """Return the covariance of the features of a run."""
        return self.library.repeat.covariance(self.conditions.noise)

    def covariance(self, runs: int) -> np.ndarray:
        """Return the covariance of what the right model leaves; `runs` 0: on the quadratic."""
        library = self.library
        found = library.surrogate.covariance(self.conditions.noise)
        if runs:
            found = (1.0 + 1.0 / runs) * self.noise() + library.carried**2 * found
        if library.left is not None:
            found[np.diag_indices_from(found)] += library.left.spread**2
        return found

    def whitener(self, runs: int, before: np.ndarray | None = None) -> Whitener:
        """Return the whitening; `before`: features without a law, to which its error belongs."""
        key = runs, b"" if before is None else before.tobytes()
        if (type(self) is TestedUnit and self.library.left is None and not runs
                and before is None and not self.scatter.any()):  # that of the library
            deviation = self.library.surrogate.deviation(self.conditions.noise)
            return Whitener(deviation=deviation, root=self.library.root)
        if key not in self._whiteners:
            found = self.covariance(runs)
            found[np.diag_indices_from(found)] += (runs + 1.0) / max(runs, 1) * self.scatter
            if before is not None:
                found[np.diag_indices_from(found)] += (LAW_ERROR * (self.values - before)) ** 2
            deviation = np.sqrt(np.diag(found))
            self._whiteners[key] = Whitener(
                deviation=deviation,
                root=cholesky(found / np.outer(deviation, deviation), lower=True))
        return self._whiteners[key]

    def cost(self, white: Whitener, mean: np.ndarray, z: np.ndarray) -> float:
        """Return J."""
        rest = white.residual(self.values - mean)
        return float(rest @ rest + self.weight @ (z - self.centre) ** 2)

    def run(self, terms: Sequence[EffectTerm], z: np.ndarray, runs: int, salt: int = 0
            ) -> np.ndarray:
        """Return the mean features of runs of a model, shape (d,)."""
        return self.run_all([(terms, z)], runs, salt)[0]

    def run_all(
        self, models: Sequence[tuple[Sequence[EffectTerm], np.ndarray]], runs: int, salt: int = 0,
        *, apart: bool = False,
    ) -> list[np.ndarray]:
        """Return the mean features of runs of each model, with the same noise unless `apart`."""
        library = self.library
        if not models:
            return []
        seeds = np.random.default_rng([self.seed, 31, salt]).integers(
            2**31, size=(len(models) if apart else 1, runs))
        jobs = [(with_terms(terms, library.model.effects), z, int(s))
                for k, (terms, z) in enumerate(models) for s in seeds[k if apart else 0]]

        def one(job: tuple[Effects, np.ndarray, int]) -> np.ndarray:
            effects, z, seed = job
            key = effects, z.tobytes(), seed
            if key not in self._runs:  # a descent may begin where another one ended
                self._runs[key] = self.simulator(library.model, library.spread, library.fmap, z,
                                                 self.conditions, seed, effects)
            return self._runs[key]

        rows = np.array(list(_threads(self.workers).map(one, jobs)))
        left = 0.0 if library.left is None else library.left.mean
        return list(rows.reshape(len(models), runs, -1).mean(axis=1) + left)

    def without_law(self) -> LawFit:
        """Return the fit of no law on the quadratic: what recalibration can do."""
        return self.on_library((), [self.centre])

    def on_library(
        self, terms: tuple[EffectTerm, ...], starts: Sequence[np.ndarray]
    ) -> LawFit:
        """Return a fit on the quadratic and the signatures, without a run.

        From each start two descents, for other minima lie far off: one begins with least squares.
        """
        white = self.whitener(0)
        plain = replace(white, straight=True)
        found = [self._recalibrated(white, *start) for z in starts for start in (
            (terms, z), self._recalibrated(plain, terms, z)[:2])]
        terms, z, cost = min(found, key=lambda row: row[2])
        return LawFit(terms=terms, z=z, mean=self.known(terms, z), cost=cost, runs=0,
                      slopes=self._known_slopes(terms, z))

    def means(self, z: np.ndarray) -> np.ndarray:
        """Return what the quadratic predicts for units without a law, (n, width) -> (n, d)."""
        return self.library.means(z, self.conditions)

    def slope(self, z: np.ndarray) -> np.ndarray:
        """Return the derivative of `means`, shape (d, width)."""
        return self.library.slope(z, self.conditions)

    def known(self, terms: Sequence[EffectTerm], z: np.ndarray) -> np.ndarray:
        """Return what the quadratic and the signatures predict, shape (d,)."""
        return np.asarray(sum((t.signature.at(t.u) for t in terms), self.means(z[None])[0]))

    def _known_slopes(self, terms: Sequence[EffectTerm], z: np.ndarray) -> np.ndarray:
        own = self.slope(z)
        return np.hstack([library_slopes(terms), own]) if terms else own

    def _recalibrated(
        self, white: Whitener, terms: tuple[EffectTerm, ...], z: np.ndarray
    ) -> tuple[tuple[EffectTerm, ...], np.ndarray, float]:
        """Return where damped steps without runs end, and the cost there."""
        mean, damping, free = self.known(terms, z), 0.0, sum(t.variant.size for t in terms)
        cost = self.cost(white, mean, z)
        for _ in range(QUADRATIC_STEPS):
            slopes = self._known_slopes(terms, z)
            for _ in range(DAMPINGS):
                step = self._step(white, mean, slopes, z, terms, damping)
                there = np.clip(z + step[free:], -self.edge, self.edge)
                laws = moved(terms, coordinates(terms) + step[:free])
                found = self.known(laws, there)
                lower = self.cost(white, found, there)
                if lower < cost:
                    break
                damping = max(10.0 * damping, 0.01)
            gained, damping = cost - lower, 0.1 * damping
            if gained > 0.0:
                terms, z, mean, cost = laws, there, found, lower
            if gained < 1e-3 * cost:
                break
        return terms, z, cost

    def settled(self, fit: LawFit, before: np.ndarray | None, runs: int, salt: int = 7) -> LawFit:
        """Return a fit on fresh runs at its point, with a last linear step."""
        mean = self.run(fit.terms, fit.z, runs, salt)
        if not np.isfinite(mean).all():
            return replace(fit, cost=np.inf)
        return self.settled_at(fit, mean, self.whitener(runs, before), runs)

    def settled_at(self, fit: LawFit, mean: np.ndarray, white: Whitener, runs: int) -> LawFit:
        """Return a fit after a linear step from `mean`, that of runs at its point."""
        step = self._step(white, mean, fit.slopes, fit.z, fit.terms, 0.0)
        terms = moved(fit.terms, coordinates(fit.terms) + step[:fit.free])
        there, z = mean + fit.slopes @ step, fit.z + step[fit.free:]
        return LawFit(terms=terms, z=z, mean=there, slopes=fit.slopes, runs=runs,
                      cost=self.cost(white, there, z))

    def descended(self, fit: LawFit, before: np.ndarray, *, runs: int, steps: int) -> LawFit:
        """Return a fit of lower cost, by damped Gauss-Newton steps on runs.

        Slopes to the laws are simulated where these are strong, and mended by what a step did.
        """
        white, damping = self.whitener(runs, before), 1e-3
        point = self.begun(fit, white, runs)
        if not np.isfinite(point.cost):
            return point
        point = replace(point, slopes=np.hstack([
            law_slopes(self.run_all, fit, point.mean, white, runs), fit.slopes[:, fit.free:]]))
        for _ in range(steps):
            moves = self._moves(point, (damping,), white, runs)
            for there in sorted(moves, key=lambda f: f.cost):
                done = np.append(
                    coordinates(there.terms) - coordinates(point.terms), there.z - point.z)
                slopes = mended(point.slopes, done, there.mean - point.mean,
                                np.append(law_sizes(point.terms), np.ones(len(there.z))))
                gained = point.cost - there.cost
                if gained > 0.0:
                    point, damping = replace(there, slopes=slopes), 0.3 * damping
                    if gained < FALL * (there.cost + gained):
                        return point
                    break
                point = replace(point, slopes=slopes)
            else:
                damping = max(10.0 * damping, 0.1)
        return point

    def refitted(self, fit: LawFit, before: np.ndarray, *, runs: int) -> LawFit:
        """Return a fit of lower cost, with slopes to all numbers simulated at each step.

        Of several dampings the best counts; it ends once the cost falls by less than `FALL`.
        """
        white = self.whitener(runs, before)
        point, last = self.begun(fit, white, runs), np.inf
        while point.cost < (1.0 - FALL) * last:
            slopes = np.hstack([law_slopes(self.run_all, point, point.mean, white, runs),
                                simulated_slopes(self.run_all, point, runs // 2)])
            last, found = point.cost, self._moves(
                replace(point, slopes=slopes), STEP_DAMPINGS, white, runs)
            point = min([point, *found], key=lambda f: f.cost)
        return point

    def begun(self, fit: LawFit, white: Whitener, runs: int) -> LawFit:
        """Return a fit with what runs at its point leave."""
        mean = self.run(fit.terms, fit.z, runs)
        return replace(fit, mean=mean, runs=runs, cost=self.cost(white, mean, fit.z)
                       if np.isfinite(mean).all() else np.inf)

    def _moves(
        self, point: LawFit, dampings: Sequence[float], white: Whitener, runs: int
    ) -> list[LawFit]:
        """Return where steps of each damping lead, those that can be run."""
        # What is far off has no weight in residuals that are bent: also of them as they are.
        steps = [self._step(scale, point.mean, point.slopes, point.z, point.terms, damping)
                 for damping in dampings for scale in (white, replace(white, straight=True))]
        tried = [(moved(point.terms, coordinates(point.terms) + step[:point.free]),
                  np.clip(point.z + step[point.free:], -self.edge, self.edge)) for step in steps]
        return [replace(point, terms=terms, z=z, mean=mean, cost=self.cost(white, mean, z))
                for (terms, z), mean in zip(tried, self.run_all(tried, runs))
                if np.isfinite(mean).all()]

    def _step(
        self, white: Whitener, mean: np.ndarray, slopes: np.ndarray, z: np.ndarray,
        terms: tuple[EffectTerm, ...], damping: float,
    ) -> np.ndarray:
        both = white.system(slopes, self.values - mean)
        u, (low, high) = coordinates(terms), bounds(terms)
        weight = np.append(np.zeros(len(u)), self.weight)
        reach = np.maximum(law_sizes(terms), [
            2.0 * least_size(t.signature) for t in terms for _ in range(t.variant.size)])
        lower = np.append(np.maximum(low - u, -reach), -self.edge - z)
        upper = np.append(np.minimum(high - u, reach), self.edge - z)
        return bounded_least_squares(
            both[:, :-1], both[:, -1], np.minimum(lower, -1e-9), np.maximum(upper, 1e-9), weight,
            np.append(u, z - self.centre), damping)


def units_aside(library: FleetLibrary) -> list[TestedUnit | None]:
    """Return the units set aside in their order; None where a run failed."""
    return [TestedUnit(library=library, values=values, conditions=conditions_of(row))
            if np.isfinite(values).all() else None for row, values in zip(*library.aside)]
