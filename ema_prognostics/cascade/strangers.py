"""Strangers: what befalls actuators and is no fault of the classes, told by matched filters.

They see what is left of a record when the guard has taken off what a fault of any size explains.
A small shift of many of these residuals is hard to see in the scatter of known records, unless
they are weighted by its inverse covariance (R. A. Fisher, Ann. Eugenics 7 (1936) 179). One such
filter for each kind needs only its mean direction, which few examples give; a network would have
to learn the covariance from them too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ema_prognostics.cascade.guard import GROUP_SQUEEZE, squeeze
from ema_prognostics.cascade.model_body import StrangersPart

RATE = 0.003
"""Part of the known records of which a stranger may be said: a tenth of what may be unknown."""


class Strange(NamedTuple):
    """What the filters say of records."""

    score: np.ndarray
    """Largest output over its limit, shape (n,); above 1: unusual."""
    kind: tuple[str, ...]
    """Of the filter that it is of."""
    rate: np.ndarray
    """Part of the known records that score as much, shape (n,): by the tail of a normal law."""


class StrangerFilters:
    """The filters at work."""

    def __init__(self, part: StrangersPart) -> None:
        """Keep the weights as arrays."""
        self._kinds = tuple(part.filters)
        self._weights = np.array([one.weights for one in part.filters.values()]).T
        self._turned = np.array([one.turns == 3 for one in part.filters.values()])
        self._limits = np.array([one.limits for one in part.filters.values()])

    def outputs(self, turned: list[np.ndarray]) -> np.ndarray:
        """Return the size of each filter's output, shape (n, kinds), from any phase.

        Parameters
        ----------
        turned : of ndarray, shape (n, m). The guard's residuals as seen from each phase.
        """
        size = np.abs([squeeze(z, GROUP_SQUEEZE) @ self._weights for z in turned])
        return np.where(self._turned, size.max(axis=0), size[0])

    def __call__(self, turned: list[np.ndarray], kind: np.ndarray) -> Strange:
        """Return what is said of records.

        Parameters
        ----------
        turned : as in `outputs`.
        kind : ndarray of int, shape (n,). What is found in each, of `KINDS_FOUND`.
        """
        ratio = self.outputs(turned) / self._limits[:, kind].T
        best = ratio.argmax(axis=1)
        score = ratio[np.arange(len(ratio)), best]
        return Strange(score, tuple(self._kinds[k] for k in best), RATE ** (score**2))
