"""Starts: every candidate at many sizes against the measurement, on the bent scale.

A large effect is not a small one scaled up. Signatures of the library are therefore compared at
each of their sizes, with differences on a logarithmic scale and the tolerances integrated out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.surrogate.evidence import Evidence
from ema_identification.actuator.surrogate.fit import Fit
from ema_identification.actuator.surrogate.likelihood import (
    BAND,
    BEND,
    BENT_ERROR,
    WEIGHT,
    Metric,
    bounded_least_squares,
    metric,
    nominal,
)
from ema_identification.actuator.surrogate.signatures import Signature

ANGLES = 12
SPREAD = (0.1, 0.3, 0.5, 0.7, 1.0, 1.4)
"""Radii of a vector whose library has one level, in units of it."""
FREE = 0.5
"""Part of an effect found before by which it may give way."""
BETWEEN = 2
"""Points between two levels."""


class Sized(NamedTuple):
    """A signature at the size at which it comes nearest to the measurement."""

    signature: Signature
    u: np.ndarray
    cost: float
    z: np.ndarray
    """Tolerances that go with it."""


def grid(signature: Signature) -> list[np.ndarray]:
    """Return the coordinates at which a signature is compared."""
    levels, size = signature.levels, signature.variant.size
    if size == 2 and len(levels[1]) > 1 and np.isclose(levels[0].max(), levels[1].max()):
        radii = levels[0][levels[0] > 0.0]
        if len(radii) == 1:
            radii = radii[0] * np.array(SPREAD)
        else:
            radii = np.unique(np.concatenate([radii, np.sqrt(radii[1:] * radii[:-1])]))
        return [r * np.array([math.cos(a), math.sin(a)])
                for r in radii for a in 2.0 * math.pi * np.arange(ANGLES) / ANGLES]
    found = []
    for k, row in enumerate(levels):
        steps = np.linspace(0.0, 1.0, BETWEEN + 1, endpoint=False)
        dense = [a + s * (b - a) for a, b in zip(row, row[1:]) for s in steps]
        for x in (*dense, *row[-1:]):
            if x != 0.0:
                u = np.zeros(size)
                u[k] = x
                found.append(u)
    return found


class Sizing:
    """Measurement and library on the bent scale, about the nominal unit."""

    def __init__(
        self, evidence: Evidence, *, added: np.ndarray | None = None, about: Fit | None = None
    ) -> None:
        """Compare about the nominal unit.

        Parameters
        ----------
        evidence : the records.
        added : ndarray, shape (d,), or None. Features that another effect adds.
        about : a fit to compare about instead; its own effects are left free.
        """
        self.evidence = evidence
        self._ends = np.cumsum([len(b) for b in evidence.blocks])[:-1]
        if about is None:
            self.base, self._centre = nominal(evidence), np.zeros(evidence.tolerances.size)
            slope = np.vstack(evidence.slopes(self._centre))
        else:
            self.base, self._centre = list(about.mean), about.z
            own = about.slopes[:, :about.free] * np.repeat(
                [FREE * float(np.linalg.norm(t.u)) for t in about.terms],
                [t.variant.size for t in about.terms])
            slope = np.hstack([about.slopes[:, about.free:], own])
        if added is not None:
            self.base = [f + part for f, part in zip(self.base, np.split(added, self._ends))]
        self._rule = metric(evidence, self.base, runs=0, error=BENT_ERROR, bend=BEND, slope=slope)
        self._inner: Metric = metric(evidence, self.base, runs=0, error=BENT_ERROR, bend=BEND)
        self._columns = self._inner.columns(
            evidence, slope[:, :len(self._centre)], [b.values for b in evidence.blocks])
        self.target = self._rule.residual(evidence, self.base)

    def seen(self, added: np.ndarray) -> np.ndarray:
        """Return what effects add, shape (d, m), on the bent scale and whitened."""
        parts = np.split(added, self._ends)
        return np.vstack([
            white(self._rule.bent(k, f[:, None] + part))
            for k, (white, f, part) in enumerate(zip(self._rule.white, self.base, parts))])

    def tolerances(self, added: np.ndarray) -> np.ndarray:
        """Return the tolerances that go best with what effects add, shape (d,)."""
        mean = [f + part for f, part in zip(self.base, np.split(added, self._ends))]
        rest = self._inner.residual(self.evidence, mean)
        z, n = self._centre, len(self._centre)
        step = bounded_least_squares(self._columns, rest, -BAND - 1e-9 - z, BAND + 1e-9 - z,
                                     np.full(n, WEIGHT), z)
        return np.asarray(np.clip(z + step, -BAND, BAND))

    def best(self, signature: Signature, more: Sequence[np.ndarray] = ()) -> Sized:
        """Return a signature at its best size.

        Parameters
        ----------
        signature : of all records, stacked.
        more : further coordinates to compare.
        """
        points = [*grid(signature), *(u for u in more if np.any(u != 0.0))]
        added = np.array([signature.at(u) for u in points]).T
        cost = ((self.target[:, None] - self.seen(added))**2).sum(axis=0)
        k = int(np.argmin(cost))
        return Sized(signature, points[k], float(cost[k]), self.tolerances(added[:, k]))
