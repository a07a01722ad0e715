"""Laws in a fit: a variant of the catalogue at its coordinates, and what was fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from ema_identification.actuator.laws.catalogue import Signature, Variant
from ema_sim.effects import EFFECTS, Effects
from ema_sim.effects.base import Choice

SURE = 0.95
"""Requirement: confidence in what is said, of the level, of a set of names, of a gap's bound."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectTerm:
    """One effect in a joint fit."""

    variant: Variant
    signature: Signature
    """Of all records, stacked; gives first slopes."""
    u: np.ndarray


@dataclass(frozen=True, kw_only=True)
class LawFit:
    """A model fitted to a record: no law, one, two.

    Attributes
    ----------
    terms : the laws at their coordinates.
    z : ndarray, shape (width,). Of a single record width = that of the library.
    mean : ndarray, shape (d,). Features as predicted.
    slopes : ndarray, shape (d, coordinates + width).
    cost : J.
    runs : that `mean` is the mean of; 0: the quadratic's.
    """

    terms: tuple[EffectTerm, ...]
    z: np.ndarray
    mean: np.ndarray
    slopes: np.ndarray
    cost: float
    runs: int

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the laws."""
        return tuple(t.variant.effect for t in self.terms)

    @property
    def variants(self) -> tuple[str, ...]:
        """Return the names of their variants."""
        return tuple(t.variant.name for t in self.terms)

    @property
    def free(self) -> int:
        """Number of coordinates of the laws."""
        return sum(t.variant.size for t in self.terms)

    def alone(self) -> list[LawFit]:
        """Return where fits of each law alone may begin."""
        found, begin, rest = [], 0, np.arange(self.free, self.slopes.shape[1])
        for term in self.terms:
            columns = np.append(np.arange(begin, begin + term.variant.size), rest)
            found.append(replace(self, terms=(term,), slopes=self.slopes[:, columns], cost=np.inf))
            begin += term.variant.size
        return found


@dataclass(frozen=True, kw_only=True)
class LawGap:
    """The gap of models on records.

    Attributes
    ----------
    values : of each model.
    healthy : ndarray, shape (n,). Of healthy units without a law.
    rest : of each model the residual in standard deviations, shape (d,).
    """

    values: tuple[float, ...]
    healthy: np.ndarray
    rest: tuple[np.ndarray, ...] = ()

    @property
    def floor(self) -> float:
        """What healthy units leave, the median."""
        return float(np.median(self.healthy))

    @property
    def bound(self) -> float:
        """What `SURE` of them stay within."""
        return float(np.quantile(self.healthy, SURE, method="higher"))

    def left(self, share: float) -> float:
        """Return what a model leaves that closes this share of the squares beyond the floor."""
        least = min(self.floor, self.values[0])
        return float(np.sqrt(least**2 + (1.0 - share) * (self.values[0] ** 2 - least**2)))

    def closes(self, share: float) -> bool:
        """Whether the last model closes this share of a gap that is beyond the bound."""
        return self.values[0] > self.bound and self.values[-1] <= self.left(share)


class LawJudge(Protocol):
    """Held-out records."""

    def gap(self, models: Sequence[LawFit], edge: float = 1.0, known: Posterior | None = None
            ) -> LawGap:
        """Return the gap of each model, the first without a law."""


class NoiseScale(Protocol):
    """What features may be off."""

    @property
    def deviation(self) -> np.ndarray:
        """Return the deviations, shape (d,)."""

    def bent(self, rest: np.ndarray) -> np.ndarray:
        """Return residuals, in deviations, of which far ones count by their logarithm."""


class Posterior(NamedTuple):
    """Laws' coordinates, then the unit's numbers: shape (m,), and covariance, shape (m, m)."""

    mean: np.ndarray
    covariance: np.ndarray


def with_terms(terms: Sequence[EffectTerm], base: Effects) -> Effects:
    """Return `base` with the effects of `terms`."""
    for term in terms:
        base = term.variant.effects(term.u, base)
    return base


def coordinates(terms: Sequence[EffectTerm]) -> np.ndarray:
    """Return the coordinates of all terms, one after another."""
    return np.concatenate([np.zeros(0), *(t.u for t in terms)])


def bounds(terms: Sequence[EffectTerm]) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of the coordinates."""
    return (np.concatenate([np.zeros(0), *(t.variant.low for t in terms)]),
            np.concatenate([np.zeros(0), *(t.variant.high for t in terms)]))


def moved(terms: Sequence[EffectTerm], u: np.ndarray) -> tuple[EffectTerm, ...]:
    """Return the terms at other coordinates, within their bounds."""
    parts = np.split(u, np.cumsum([t.variant.size for t in terms], dtype=int)[:-1])
    return tuple(replace(term, u=np.clip(part, term.variant.low, term.variant.high))
                 for term, part in zip(terms, parts))


def law_sizes(terms: Sequence[EffectTerm]) -> np.ndarray:
    """Return the size of the law of each coordinate."""
    return np.concatenate([np.zeros(0), *(
        np.full(t.variant.size, max(float(np.linalg.norm(t.u)), 1e-12)) for t in terms)])


def library_slopes(terms: Sequence[EffectTerm]) -> np.ndarray:
    """Return the slopes to the coordinates as the library knows them."""
    return np.hstack([t.signature.slope(t.u) for t in terms])


def choices_of(term: EffectTerm) -> dict[str, str]:
    """Return the choices of an effect by name: its phase, its mode."""
    kinds = {f.name: f.kind for f in EFFECTS[term.variant.effect].fields}
    return {f"{term.variant.effect}.{name}": kind.options[int(value)]
            for name, value in term.variant.settings(term.u).items()
            if isinstance(kind := kinds[name], Choice)}
