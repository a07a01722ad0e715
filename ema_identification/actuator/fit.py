"""Effects fitted together with the tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.actuator.effect_library import Signature
from ema_identification.actuator.variants import Variant
from ema_sim.effects import Effects

INFLATION = 2.5
"""On standard deviations: the slopes of the library are themselves estimates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """One effect in a joint fit."""

    variant: Variant
    signature: Signature
    """Of all records, stacked; gives first slopes."""
    u: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """Effects fitted together with the tolerances.

    Attributes
    ----------
    terms : the effects at their fitted coordinates.
    z : ndarray. Tolerances in half widths.
    covariance : ndarray, of the coordinates of all terms and then the tolerances.
    cost : sum of squares of the whitened residual, prior included.
    mean : features of each record as predicted at the fit.
    runs : how many runs `mean` stands on.
    slopes : ndarray, shape (d, coordinates + tolerances). Of the stacked features, at the fit.
    inflation : of standard deviations, for the errors of the slopes.
    """

    terms: tuple[Term, ...]
    z: np.ndarray
    covariance: np.ndarray
    cost: float
    mean: tuple[np.ndarray, ...]
    runs: int
    slopes: np.ndarray
    inflation: float = INFLATION

    @property
    def free(self) -> int:
        """Number of coordinates of the effects."""
        return sum(t.variant.size for t in self.terms)

    @property
    def spread(self) -> float:
        """Residual in units of the noise that was assumed."""
        return float(np.sqrt(self.cost / sum(len(f) for f in self.mean)))

    def effects(self, base: Effects) -> Effects:
        """Return `base` with the fitted effects."""
        return with_terms(self.terms, base)


def with_terms(terms: Sequence[Term], base: Effects) -> Effects:
    """Return `base` with the effects of `terms`."""
    for term in terms:
        base = term.variant.effects(term.u, base)
    return base


def coordinates(terms: Sequence[Term]) -> np.ndarray:
    """Return the coordinates of all terms, one after another."""
    return np.concatenate([t.u for t in terms])


def bounds(terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of the coordinates."""
    return (np.concatenate([t.variant.low for t in terms]),
            np.concatenate([t.variant.high for t in terms]))


def moved(terms: Sequence[Term], u: np.ndarray) -> tuple[Term, ...]:
    """Return the terms at other coordinates, within their bounds."""
    found, k = [], 0
    for term in terms:
        n = term.variant.size
        part = np.clip(u[k:k + n], term.variant.low, term.variant.high)
        found.append(Term(variant=term.variant, signature=term.signature, u=part))
        k += n
    return tuple(found)
