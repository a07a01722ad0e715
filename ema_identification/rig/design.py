"""`Design`: the regressors of terms along one trajectory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.rig.laws import Term
from ema_identification.rig.regression import fit
from ema_identification.rig.trajectory import Segment, Trajectory

AT_ONCE = 40
"""Terms whose regressors are filtered together."""


class Design:
    """Regressors of terms along one trajectory, each evaluated once.

    Parameters
    ----------
    trajectory : Trajectory
        Where the laws are evaluated.

    Attributes
    ----------
    lead : float
        By how much the input is later than it was recorded (s).

    """

    def __init__(self, trajectory: Trajectory) -> None:
        """Start with no regressor evaluated."""
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
            columns = self._side_by_side(some)
            at = 0
            for term in some:
                count = len(term.law.coefficients)
                self._cache[term.key] = columns[:, at:at + count]
                at += count

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

    def matrix(
        self, terms: Sequence[Term], coefficients: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the regressors of all terms side by side, shape (rows, columns)."""
        parts = [
            self.of_prediction(term, terms, coefficients) if term.law.of_prediction
            else self.columns(term)
            for term in terms
        ]
        if not parts:
            return np.empty((len(self.trajectory.target), 0))
        return np.concatenate(parts, axis=1)
