"""The balance at the input port: its terms, their regressors, and the fit of one to the other.

`Design` holds the regressors along one trajectory, `InputBalance` the terms and their fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ema_identification.rig.fit.regression import (
    Blocks,
    CoefficientBounds,
    LinearFit,
    fit,
    held_out,
)
from ema_identification.rig.laws.base import LEAST_PART, MOST_PART, Term
from ema_identification.rig.signals.trajectory import Segment, Trajectory

AT_ONCE = 40
"""Terms whose regressors are filtered together."""


class Design:
    """Regressors of terms along one trajectory, each evaluated once.

    Parameters
    ----------
    trajectory : where the laws are evaluated.

    Attributes
    ----------
    lead : by how much the input is later than it was recorded (s).
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.lead = 0.0
        self._recorded = trajectory
        self._cache: dict[tuple[str, tuple[float, ...]], np.ndarray] = {}

    def led(self, lead: float) -> Design:
        """Return the design with the input later by `lead` (s) than it was recorded."""
        if lead == self.lead:
            return self
        other = Design(self._recorded.later(lead) if lead else self._recorded)
        other._recorded, other._cache, other.lead = self._recorded, self._cache, lead
        return other

    def columns(self, term: Term, trajectory: Trajectory | None = None) -> np.ndarray:
        """Return the regressors of one term, shape (rows, k)."""
        if trajectory is None and term.key in self._cache:
            return self._cache[term.key]
        where = trajectory or self.trajectory
        columns = where.reduce(
            lambda segment: np.column_stack(term.law.columns(segment, where, term.shape)))
        if trajectory is None and not term.law.of_prediction:
            self._cache[term.key] = columns
        return columns

    def evaluate(self, terms: Sequence[Term]) -> None:
        """Evaluate the regressors of many terms at once, which is quicker than one by one."""
        new = [term for term in terms if term.key not in self._cache]
        for first in range(0, len(new), AT_ONCE):
            some = new[first:first + AT_ONCE]
            ends = np.cumsum([len(term.law.coefficients) for term in some])
            for term, columns in zip(some, np.split(self._side_by_side(some), ends[:-1], axis=1)):
                self._cache[term.key] = columns

    def _side_by_side(self, terms: Sequence[Term]) -> np.ndarray:
        return self.trajectory.reduce(lambda segment: np.column_stack([
            column for term in terms
            for column in term.law.columns(segment, self.trajectory, term.shape)]))

    def predicted(self, terms: Sequence[Term], coefficients: np.ndarray) -> Trajectory:
        """Return the trajectory with what `terms` predict of the input."""
        def of(segment: Segment) -> np.ndarray:
            total = np.zeros(len(segment))
            at = 0
            for term in terms:
                for column in term.law.columns(segment, self.trajectory, term.shape):
                    total += coefficients[at] * column
                    at += 1
            return total

        return self.trajectory.predicted([of(s) for s in self.trajectory.segments])

    def of_prediction(
        self, term: Term, terms: Sequence[Term], coefficients: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the regressors of a law that looks at the prediction of other terms.

        Without `coefficients` those of the least-squares fit here are taken.
        """
        plain = [t for t in terms if not t.law.of_prediction]
        if coefficients is None:
            found = fit(self.matrix(plain), self.trajectory.target).coefficients
        else:
            keep = np.concatenate([
                np.full(len(t.law.coefficients), not t.law.of_prediction) for t in terms])
            found = coefficients[keep]
        return self.columns(term, self.predicted(plain, found))

    def of_each(self, term: Term, terms: Sequence[Term]) -> np.ndarray:
        """Return the regressor of a law that is linear in the prediction, for each regressor.

        Returns
        -------
        ndarray, shape (rows, k)
            Of the k regressors of `terms`, which may not look at the prediction themselves.
        """
        parts = []
        for plain in terms:
            key = (f"{term.law.name} of {plain.law.name}", plain.shape)
            if key not in self._cache:
                count = len(plain.law.coefficients)
                self._cache[key] = np.column_stack([
                    self.columns(term, self.predicted([plain], np.eye(count)[k]))
                    for k in range(count)])
            parts.append(self._cache[key])
        return np.concatenate(parts, axis=1)

    def matrix(self, terms: Sequence[Term], coefficients: np.ndarray | None = None) -> np.ndarray:
        """Return the regressors of all terms side by side, shape (rows, columns)."""
        parts = [
            self.of_prediction(term, terms, coefficients) if term.law.of_prediction
            else self.columns(term)
            for term in terms
        ]
        if not parts:
            return np.empty((len(self.trajectory.target), 0))
        return np.concatenate(parts, axis=1)


BASE_LAWS = ("inertia", "viscous_friction", "disturbance")
"""What every axis has."""
OWN_PREDICTION, SETTLED = 20, 1e-4
"""Times that regressors made of the prediction are made again of the fit with them, at most; and
the relative change of its coefficients at which they are settled."""


@dataclass(frozen=True, kw_only=True)
class InputBalance:
    """The terms of a model fitted to the input port, within the bounds of what is known."""

    design: Design
    terms: tuple[Term, ...]
    bounds: CoefficientBounds

    @cached_property
    def columns(self) -> np.ndarray:
        """Regressors, shape (rows, columns); those of the prediction are of this very fit."""
        looking = [k for k, term in enumerate(self.terms) if term.law.of_prediction]
        if len(looking) == 1 and self.terms[looking[0]].law.linear and len(self.terms) > 1:
            return self._of_own_prediction(looking[0])
        columns = self.design.matrix(self.terms)
        if looking:
            before = np.full(columns.shape[1], np.inf)
            for _ in range(OWN_PREDICTION):
                found = fit(columns, self.design.trajectory.target, self.bounds).coefficients
                columns = self.design.matrix(self.terms, found)
                if np.allclose(found, before, rtol=SETTLED, atol=0.0):
                    break
                before = found
        return columns

    def _of_own_prediction(self, index: int) -> np.ndarray:
        """Return the regressors with the one of a law that is linear in the prediction.

        The prediction's own coefficients and that of the law, τ, follow together: Gauss and
        Newton's step of ``u = X c + τ D c``.
        """
        term, place = self.terms[index], self.span(index).start
        plain = [*self.terms[:index], *self.terms[index + 1:]]
        x, d = self.design.matrix(plain), self.design.of_each(term, plain)
        target = self.design.trajectory.target
        found = np.insert(fit(x, target).coefficients, place, 0.0)
        for _ in range(OWN_PREDICTION):
            slope = d @ np.delete(found, place)
            before, found = found, fit(
                np.insert(x + found[place] * d, place, slope, axis=1),
                target + found[place] * slope, self.bounds).coefficients
            if np.allclose(found, before, rtol=SETTLED, atol=0.0):
                break
        return np.insert(x, place, d @ np.delete(found, place), axis=1)

    @cached_property
    def fit(self) -> LinearFit:
        """The fit within bounds."""
        return fit(self.columns, self.design.trajectory.target, self.bounds)

    @property
    def fixed(self) -> np.ndarray:
        """Whether each coefficient stands at a bound or is known exactly, shape (columns,)."""
        return np.asarray(self.fit.active | (self.bounds.low == self.bounds.high))

    @cached_property
    def target(self) -> np.ndarray:
        """Input less what is fixed, shape (rows,)."""
        fixed = self.fixed
        return np.asarray(self.design.trajectory.target - (
            self.columns[:, fixed] @ self.fit.coefficients[fixed]))

    @cached_property
    def free_columns(self) -> np.ndarray:
        """Regressors whose coefficients are free."""
        return self.columns[:, ~self.fixed]

    def held_out(self, blocks: Blocks) -> np.ndarray:
        """Return the residual of each row under the fit of all other blocks, shape (rows,)."""
        return held_out(self.free_columns, self.target, blocks)

    def squares(self, blocks: Blocks) -> float:
        """Return the sum of the squares of `held_out`."""
        return float(np.sum(self.held_out(blocks) ** 2))

    def squares_beside(self, columns: np.ndarray, blocks: Blocks) -> float:
        """Return that sum with further regressors beside the free ones, shape (rows, k)."""
        rest = held_out(np.column_stack([self.free_columns, columns]), self.target, blocks)
        return float(rest @ rest)

    def columns_of(self, term: Term) -> np.ndarray:
        """Return the regressors of a term that might be added, shape (rows, k)."""
        if term.law.of_prediction:
            return self.design.of_prediction(term, self.terms)
        return self.design.columns(term)

    def joined(self, term: Term) -> InputBalance:
        """Return the balance with one more term, free; it takes the place of its like."""
        count = len(term.law.coefficients)
        low = np.append(self.bounds.low, np.full(count, 0.0 if term.law.positive else -np.inf))
        high = np.append(self.bounds.high, np.full(count, np.inf))
        for index, other in enumerate(self.terms):
            if other.key == term.key:
                low[self.span(index)] = high[self.span(index)] = 0.0
        return replace(self, terms=(*self.terms, term),
                       bounds=CoefficientBounds(low=low, high=high))

    def replaced(self, index: int) -> bool:
        """Return whether a later term takes the place of the one at `index`."""
        span = self.span(index)
        return not (self.bounds.low[span].any() or self.bounds.high[span].any())

    @property
    def names(self) -> list[str]:
        """Names of the laws of all terms, in order."""
        return [term.law.name for term in self.terms]

    @property
    def lawful(self) -> bool:
        """Whether no law that was added would have to break its sign: friction that drives.

        The model's own inertia and viscous friction stop at zero instead. A part is neither
        little nor nearly all of its whole: without a drive's own inertia, a load on a spring
        would excuse every acceleration that the input did not make.
        """
        whole = {term.law.name: float(self.fit.coefficients[self.span(index)][0])
                 for index, term in enumerate(self.terms)}
        for term in self.terms:
            most = whole.get(term.law.part_of, 0.0)
            if term.law.part_of and not (
                    LEAST_PART * most <= whole[term.law.name] <= MOST_PART * most):
                return False
        return not any(
            bool(self.fit.active[self.span(index)].any())
            for index, term in enumerate(self.terms)
            if term.law.positive and term.law.name not in BASE_LAWS
        )

    def without(self, index: int) -> InputBalance:
        """Return the balance without the term at `index`; without a delay, as recorded."""
        span = self.span(index)
        delayed = self.terms[index].law.name == "control_delay"
        keep = np.ones(len(self.bounds.low), dtype=bool)
        keep[span] = False
        return InputBalance(
            design=self.design.led(0.0) if delayed else self.design,
            terms=self.terms[:index] + self.terms[index + 1:],
            bounds=CoefficientBounds(low=self.bounds.low[keep], high=self.bounds.high[keep]))

    def span(self, index: int) -> slice:
        """Return where the coefficients of the term at `index` stand."""
        sizes = [len(term.law.coefficients) for term in self.terms]
        first = sum(sizes[:index])
        return slice(first, first + sizes[index])

    def led(self, lead: float) -> InputBalance:
        """Return the balance with the input later by `lead` (s) than it was recorded."""
        return replace(self, design=self.design.led(lead))

    def later(self, change: float, place: int) -> InputBalance:
        """Return the balance with its input later by `change` (s) and its delay smaller by that.

        `place` is where the coefficient of the delay stands.
        """
        if change == 0.0:
            return self
        low, high = self.bounds.low.copy(), self.bounds.high.copy()
        low[place] -= change
        high[place] -= change
        return replace(self, design=self.design.led(self.design.lead + change),
                       bounds=CoefficientBounds(low=low, high=high))

    def residual_on(self, design: Design) -> np.ndarray:
        """Return the residual of this fit on another record, shape (rows there,)."""
        design = design.led(self.design.lead)
        coefficients = self.fit.coefficients
        columns = design.matrix(self.terms, coefficients)
        rest: np.ndarray = design.trajectory.target - columns @ coefficients
        in_time = np.repeat([term.law.looked_for for term in self.terms],
                            [len(term.law.coefficients) for term in self.terms])
        if in_time.any():  # a wave in time has another phase in another record
            rest = fit(columns[:, in_time],
                       rest + columns[:, in_time] @ coefficients[in_time]).residual
        return rest


def rms(values: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
