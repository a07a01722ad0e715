"""Strangers: what befalls actuators and is no fault of the classes, told by matched filters.

The scatter of known records makes a small shift of many inputs hard to see, unless they are
weighted by their inverse covariance (R. A. Fisher, Ann. Eugenics 7 (1936) 179). One such filter
for each kind of stranger needs only its mean direction, which few examples give; a network would
have to learn the covariance from them too.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from ema_prognostics.cascade.classes import KINDS_FOUND
from ema_prognostics.cascade.parts import Part, Positive, Vector

RATE = 0.01
"""Part of the known records of which a stranger may be said: a third of those that may be unknown."""


class FilterPart(Part):
    """One kind of stranger."""

    weights: Vector
    """Of the squashed inputs; the filter's variance over known records is 1."""
    turns: Literal[1, 3]
    """3: it may be of any phase, so the record is looked at from each."""
    limits: Annotated[list[Positive], Field(min_length=len(KINDS_FOUND),
                                           max_length=len(KINDS_FOUND))]
    """Largest usual size of the filter's output, by what is found, as `classes.KINDS_FOUND`."""


class StrangersPart(Part):
    """The filters, by kind."""

    filters: dict[str, FilterPart] = Field(min_length=1, max_length=40)


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
        turned : of ndarray, shape (n, inputs). Squashed inputs as seen from each phase.
        """
        size = np.abs([u @ self._weights for u in turned])
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
