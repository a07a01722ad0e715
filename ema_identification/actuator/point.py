"""Effects and tolerances as a point where the simulator was run, and runs around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.actuator.evidence import Asked, Evidence
from ema_identification.actuator.fit import Term, coordinates, moved, with_terms


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """Effects and tolerances with the features that the simulator gives there.

    Attributes
    ----------
    terms : the effects at their coordinates.
    z : ndarray. Tolerances in half widths.
    mean : features of each record, means of `runs` runs.
    slopes : ndarray or None, shape (d, coordinates + tolerances). As learnt so far.
    damping : of the next step.
    """

    terms: tuple[Term, ...]
    z: np.ndarray
    mean: tuple[np.ndarray, ...]
    runs: int
    slopes: np.ndarray | None = None
    damping: float = 1e-3

    @property
    def finite(self) -> bool:
        """Whether the simulator could run it."""
        return all(bool(np.isfinite(f).all()) for f in self.mean)


def run_point(
    evidence: Evidence, terms: tuple[Term, ...], z: np.ndarray, *, runs: int, seed: int
) -> Point:
    """Return a point with its features."""
    return run_points(evidence, [(terms, z)], runs=runs, seed=seed)[0]


def run_points(
    evidence: Evidence, places: Sequence[tuple[tuple[Term, ...], np.ndarray]], *, runs: int,
    seed: int,
) -> list[Point]:
    """Return points at effects and tolerances with their features."""
    base = evidence.blocks[0].library.model.effects
    means = evidence.means([Asked(z, with_terms(terms, base), runs, seed) for terms, z in places])
    return [Point(terms=terms, z=z, mean=tuple(mean), runs=runs)
            for (terms, z), mean in zip(places, means)]


def runs_around(
    evidence: Evidence, terms: Sequence[Term], z: np.ndarray, moves: np.ndarray,
    seeds: Sequence[int], *, band: float = np.inf,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the moves that were made, shape (n, unknowns), and the features, shape (n, d).

    Parameters
    ----------
    evidence : the records.
    terms, z : the point.
    moves : ndarray, shape (m, unknowns). From the point; cut off at the bounds.
    seeds : of each run. Those that leave the simulator's domain are left out.
    band : of the tolerances (half widths).
    """
    start, base = coordinates(terms), evidence.blocks[0].library.model.effects
    places = [(moved(terms, start + row[:len(start)]),
               np.clip(z + row[len(start):], -band, band)) for row in moves]
    means = evidence.means([Asked(tolerances, with_terms(there, base), 1, seed)
                            for (there, tolerances), seed in zip(places, seeds)])
    made, runs = [], []
    for (there, tolerances), mean in zip(places, means):
        found = np.concatenate(mean)
        if np.isfinite(found).all():
            made.append(np.concatenate([coordinates(there) - start, tolerances - z]))
            runs.append(found)
    return np.array(made).reshape(-1, len(start) + len(z)), np.array(runs)
