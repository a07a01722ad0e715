"""Slopes of the features at a point: of the library, or by the simulator where it knows more."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.aliases import ALIASES, TAKES_AWAY
from ema_identification.actuator.evidence import Asked, Evidence
from ema_identification.actuator.fit import Term, bounds, coordinates, moved, with_terms
from ema_identification.actuator.spread import N_TOLERANCES, TOLERANCES

PART = 0.2
"""Part of a coordinate by which it is moved for its slope."""
STRONG = 4.0
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


def library_slopes(terms: Sequence[Term]) -> np.ndarray:
    """Return the slopes to the coordinates as the library knows them."""
    return np.hstack([t.signature.slope(t.u) for t in terms])


def simulated_slopes(
    evidence: Evidence, terms: Sequence[Term], z: np.ndarray, mean: Sequence[np.ndarray], *,
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
        strong = float(np.sqrt(np.mean((term.signature.at(term.u) / deviation)**2))) > STRONG
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
    evidence: Evidence, terms: Sequence[Term], z: np.ndarray, slope_u: np.ndarray,
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
    evidence: Evidence, terms: Sequence[Term], z: np.ndarray, mean: Sequence[np.ndarray],
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
