"""Effects fitted together with the tolerances: terms, fits, points, and slopes about a point.

At a point the simulator was run. Slopes of the features there are those of the library, or by the
simulator where it knows more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.measure.tolerances import N_TOLERANCES, TOLERANCES
from ema_identification.actuator.surrogate.catalogue import ALIASES, TAKES_AWAY, Variant
from ema_identification.actuator.surrogate.evidence import Asked, Evidence
from ema_identification.actuator.surrogate.library import Signature
from ema_sim.effects import Effects

LIBRARY_INFLATION = 2.5
"""On standard deviations: the slopes of the library are themselves estimates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectTerm:
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
    left_behind : whether it did not go through all rounds of the contest.
    """

    terms: tuple[EffectTerm, ...]
    z: np.ndarray
    covariance: np.ndarray
    cost: float
    mean: tuple[np.ndarray, ...]
    runs: int
    slopes: np.ndarray
    inflation: float = LIBRARY_INFLATION
    left_behind: bool = False

    @property
    def free(self) -> int:
        """Number of coordinates of the effects."""
        return sum(t.variant.size for t in self.terms)

    @property
    def spread(self) -> float:
        """Residual in units of the noise that was assumed."""
        return float(np.sqrt(self.cost / sum(len(f) for f in self.mean)))

    def whitened(self, evidence: Evidence) -> list[np.ndarray]:
        """Return what the fit leaves of each record, in standard deviations."""
        return evidence.whitened(self.mean, self.runs)

    def effects(self, base: Effects) -> Effects:
        """Return `base` with the fitted effects."""
        return with_terms(self.terms, base)


def with_terms(terms: Sequence[EffectTerm], base: Effects) -> Effects:
    """Return `base` with the effects of `terms`."""
    for term in terms:
        base = term.variant.effects(term.u, base)
    return base


def coordinates(terms: Sequence[EffectTerm]) -> np.ndarray:
    """Return the coordinates of all terms, one after another."""
    return np.concatenate([t.u for t in terms])


def bounds(terms: Sequence[EffectTerm]) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of the coordinates."""
    return (np.concatenate([t.variant.low for t in terms]),
            np.concatenate([t.variant.high for t in terms]))


def moved(terms: Sequence[EffectTerm], u: np.ndarray) -> tuple[EffectTerm, ...]:
    """Return the terms at other coordinates, within their bounds."""
    found, k = [], 0
    for term in terms:
        n = term.variant.size
        part = np.clip(u[k:k + n], term.variant.low, term.variant.high)
        found.append(EffectTerm(variant=term.variant, signature=term.signature, u=part))
        k += n
    return tuple(found)


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

    terms: tuple[EffectTerm, ...]
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
    evidence: Evidence, terms: tuple[EffectTerm, ...], z: np.ndarray, *, runs: int, seed: int
) -> Point:
    """Return a point with its features."""
    return run_points(evidence, [(terms, z)], runs=runs, seed=seed)[0]


def run_points(
    evidence: Evidence, places: Sequence[tuple[tuple[EffectTerm, ...], np.ndarray]], *, runs: int,
    seed: int,
) -> list[Point]:
    """Return points at effects and tolerances with their features."""
    base = evidence.blocks[0].library.model.effects
    means = evidence.means([Asked(z, with_terms(terms, base), runs, seed) for terms, z in places])
    return [Point(terms=terms, z=z, mean=tuple(mean), runs=runs)
            for (terms, z), mean in zip(places, means)]


def runs_around(
    evidence: Evidence, terms: Sequence[EffectTerm], z: np.ndarray, moves: np.ndarray,
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


class Start(NamedTuple):
    """Effects and tolerances from which a fit begins."""

    terms: tuple[EffectTerm, ...]
    z: np.ndarray


PART = 0.2
"""Part of a coordinate by which it is moved for its slope."""
STRONG_EFFECT = 4.0
"""Rms of an effect's signature from which its slope is simulated (standard deviations)."""
TOLERANCE_STEP = 0.5
"""By which a tolerance is moved for its slope (half widths)."""
TOLERANCE_RUNS = 1
"""Runs for it: there are eighteen of them, and what they scatter is weighed."""
UNKNOWN_STEP = 0.3
"""Of a coordinate that the library does not know."""


def deviation_of(evidence: Evidence) -> np.ndarray:
    """Return the standard deviation of a repeat of the stacked features."""
    return np.concatenate([
        b.library.null.deviation(b.conditions.noise) for b in evidence.blocks])


def library_slopes(terms: Sequence[EffectTerm]) -> np.ndarray:
    """Return the slopes to the coordinates as the library knows them."""
    return np.hstack([t.signature.slope(t.u) for t in terms])


def simulated_slopes(
    evidence: Evidence, terms: Sequence[EffectTerm], z: np.ndarray, mean: Sequence[np.ndarray], *,
    runs: int, seed: int,
) -> np.ndarray:
    """Return the slopes to the coordinates: by the simulator where an effect is strong.

    The runs have the noise of those of `mean`. A weak effect is as straight as its signature,
    and less noisy there.
    """
    found = library_slopes(terms)
    here, deviation = np.concatenate(mean), deviation_of(evidence)
    base = evidence.blocks[0].library.model.effects
    low, high = bounds(terms)
    start, k = coordinates(terms), 0
    places: list[tuple[int, np.ndarray]] = []
    for term in terms:
        added = term.signature.at(term.u) / deviation
        strong = float(np.sqrt(np.mean(added**2))) > STRONG_EFFECT
        size = float(np.linalg.norm(term.u))
        for levels in term.signature.levels:
            known = len(levels) > 1
            step = PART * size if known else UNKNOWN_STEP
            if (strong and step > 0.0) or not known:
                u = start.copy()
                u[k] += step if u[k] + step <= high[k] else -step
                places.append((k, u))
            k += 1
    means = evidence.means([Asked(z, with_terms(moved(terms, u), base), runs, seed)
                            for _, u in places])
    for (k, u), there in zip(places, means):
        change = np.concatenate(there) - here
        if np.isfinite(change).all() and u[k] >= low[k]:
            found[:, k] = change / (u[k] - start[k])
    return found


def slopes_with_aliases(
    evidence: Evidence, terms: Sequence[EffectTerm], z: np.ndarray, slope_u: np.ndarray,
    known: np.ndarray | None = None,
) -> np.ndarray:
    """Return the slopes to the tolerances; those that a coordinate shares, taken from it.

    `known` holds slopes to the tolerances, shape (d, tolerances); by default the library's.

    The data cannot tell a severity from a tolerance of the same parameter; two estimates of one
    slope would pretend that they can.
    """
    names = [t.name for t in TOLERANCES]
    ends = np.cumsum([len(b) for b in evidence.blocks])[:-1]
    slopes = evidence.slopes(z) if known is None else [
        part.copy() for part in np.split(known, ends)]
    column = 0
    for term in terms:
        for k, u in enumerate(term.u):
            alias = ALIASES.get((term.variant.name, k))
            if alias is not None:
                j = names.index(alias[0])
                width = TOLERANCES[j].half_width
                at = 0
                for record, slope in enumerate(slopes):
                    own = np.zeros((len(slope), N_TOLERANCES))
                    value = evidence.tolerances.of(record, z)[j]
                    factor = width if alias[1] == 0.0 else alias[1] * width * (
                        1.0 + (-u if term.variant.effect in TAKES_AWAY else u)
                    ) / (1.0 + width * value)
                    own[:, j] = factor * slope_u[at:at + len(slope), column]
                    spread = evidence.tolerances.spread(record, own)
                    used = np.flatnonzero(np.abs(spread).sum(axis=0))
                    slope[:, used] = spread[:, used]
                    at += len(slope)
            column += 1
    return np.vstack(slopes)


def simulated_tolerances(
    evidence: Evidence, terms: Sequence[EffectTerm], z: np.ndarray, mean: Sequence[np.ndarray],
    slopes: np.ndarray, *, runs: int, seed: int,
) -> np.ndarray:
    """Return slopes to the tolerances, mended where the simulator clearly says another.

    A large effect changes what a tolerance does: half the torque constant, twice the current a
    friction needs. The library's slopes are those of the unit without the effect. `mean` is of
    `runs` runs.
    """
    base = evidence.blocks[0].library.model.effects
    effects, here = with_terms(terms, base), np.concatenate(mean)
    noise = deviation_of(evidence) * np.sqrt(1.0 / runs + 1.0 / TOLERANCE_RUNS) / TOLERANCE_STEP
    found = slopes.copy()
    steps = np.where(z < 0.0, TOLERANCE_STEP, -TOLERANCE_STEP)
    means = evidence.means([Asked(z + move, effects, TOLERANCE_RUNS, seed)
                            for move in np.diag(steps)])
    for k, there in enumerate(means):
        run = np.concatenate(there)
        if not np.isfinite(run).all():
            continue
        missed = (run - here) / steps[k] - slopes[:, k]
        ratio = (missed / (2.0 * noise))**2
        found[:, k] += missed * ratio / (1.0 + ratio)
    return found
