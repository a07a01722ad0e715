"""Fit candidates with the simulator itself, on the unit and under the conditions at hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.actuator.effect_library import Signature
from ema_identification.actuator.evidence import (
    MODEL_ERROR,
    Evidence,
    Whitening,
    noise_covariance,
    slope_noise,
    solve,
)
from ema_identification.actuator.spread import N_TOLERANCES, TOLERANCES
from ema_identification.actuator.variants import ALIASES, Variant
from ema_sim.effects import Effects

ROUNDS = 5
RUNS = 3
LAST_RUNS = 10
CLEAR = 4.0
"""Least mean square of a step, in units of a repeat, that says something on the slope."""
COARSE = 0.2
"""Share of the residual that the first round grants as error to each feature; halves a round.

So no few features on which an effect acts hard decide a step alone.
"""


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
    """

    terms: tuple[Term, ...]
    z: np.ndarray
    covariance: np.ndarray
    cost: float
    mean: tuple[np.ndarray, ...]
    runs: int
    slopes: np.ndarray

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


def _moved(terms: Sequence[Term], u: np.ndarray) -> tuple[Term, ...]:
    found, k = [], 0
    for term in terms:
        n = term.variant.size
        part = np.clip(u[k:k + n], term.variant.low, term.variant.high)
        found.append(Term(variant=term.variant, signature=term.signature, u=part))
        k += n
    return tuple(found)


def _coordinates(terms: Sequence[Term]) -> np.ndarray:
    return np.concatenate([t.u for t in terms])


def refit(
    evidence: Evidence, terms: Sequence[Term], z: np.ndarray, null: Sequence[np.ndarray], *,
    rounds: int = ROUNDS, runs: int = RUNS, last: int = LAST_RUNS, seed: int = 0,
    give_up: float = np.inf,
) -> Fit:
    """Return the joint fit of effects and tolerances.

    Parameters
    ----------
    evidence : the records.
    terms : effects at the coordinates that screening proposes.
    z : tolerances to start from.
    null : features of each record without the effects, for the size of their signature.
    rounds, runs, last : simulations, runs each, runs of the last.
    seed : of the runs.
    give_up : a fit whose cost stays above this after two rounds is not polished.
    """
    base = evidence.blocks[0].library.model.effects
    terms = tuple(terms)
    free = len(_coordinates(terms))
    best: Fit | None = None
    before: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    slope_u = np.hstack([t.signature.slope(t.u) for t in terms])
    poor = False
    for k in range(rounds):
        final = k == rounds - 1 or poor
        n = last if final and not poor else runs
        mean = evidence.mean(z, with_terms(terms, base), runs=n, seed=seed + 10 * k)
        if not all(np.isfinite(f).all() for f in mean):
            break
        slope_u = _slopes(evidence, terms, z, mean, slope_u, before, runs, seed)
        coarse = 0.0 if final else COARSE * 0.5**k
        rows, target, feigned = [], [], 0.0
        at = 0
        slopes = _with_aliases(evidence, terms, z, slope_u)
        for block, f, f0, slope_z in zip(evidence.blocks, mean, null, slopes):
            noise = noise_covariance(block, runs=n, error=np.hypot(
                MODEL_ERROR * (f - f0), coarse * (block.values - f)))
            feigned += slope_noise(block, noise)
            white = Whitening(noise)
            rows.append(white(np.hstack([slope_u[at:at + len(block)], slope_z])))
            target.append(white(block.values - f))
            at += len(block)
        step, covariance, cost = solve(
            np.vstack(rows), np.concatenate(target), z, free, feigned)
        before = (_coordinates(terms), z, np.concatenate(mean))
        u = _coordinates(terms) + step[:free]
        new_terms = _moved(terms, u)
        new_z = np.clip(z + step[free:], -2.5, 2.5)
        if final:
            change = slope_u @ (_coordinates(new_terms) - _coordinates(terms)) + np.vstack(
                slopes) @ (new_z - z)
            predicted, at = [], 0
            for f in mean:
                predicted.append(f + change[at:at + len(f)])
                at += len(f)
            best = Fit(terms=new_terms, z=new_z, covariance=covariance, cost=cost,
                       mean=tuple(predicted), runs=n,
                       slopes=np.hstack([slope_u, np.vstack(slopes)]))
            break
        terms, z = new_terms, new_z
        poor = k >= 1 and cost > give_up
    if best is None:
        return Fit(terms=terms, z=z, covariance=np.eye(free + len(z)), cost=np.inf,
                   mean=tuple(null), runs=1, slopes=np.hstack([
                       slope_u, np.vstack(evidence.slopes(z))]))
    return best


def polish(evidence: Evidence, fit: Fit, null: Sequence[np.ndarray], *, seed: int = 0) -> Fit:
    """Return a fit continued from where it ended, tolerances drawn back into their bands.

    Tolerances that took the place of an effect before it was found find their way home.
    """
    again = refit(evidence, fit.terms, np.clip(fit.z, -1.0, 1.0), null, seed=seed + 40)
    return again if again.cost < fit.cost else fit


def _slopes(
    evidence: Evidence, terms: Sequence[Term], z: np.ndarray, mean: Sequence[np.ndarray],
    slope: np.ndarray, before: tuple[np.ndarray, np.ndarray, np.ndarray] | None, runs: int,
    seed: int,
) -> np.ndarray:
    """Return the derivative of the stacked features to the coordinates.

    The library's slope is corrected by what the last step really did (Broyden); coordinates
    that the library does not know are moved a little and simulated.
    """
    here = np.concatenate(mean)
    found = slope.copy()
    unknown = _unknown(terms)
    if before is not None:
        u0, z0, f0 = before
        du = _coordinates(terms) - u0
        scale = np.maximum(np.abs(u0), 1e-12)
        weight = du / scale**2
        power = float(du @ weight)
        deviation = np.concatenate([
            b.library.null.deviation(b.conditions.noise) for b in evidence.blocks])
        if power > 0.0 and float(((slope @ du / deviation)**2).mean()) > CLEAR:
            dz = np.vstack(evidence.slopes(0.5 * (z + z0))) @ (z - z0)
            found += np.outer(here - f0 - dz - found @ du, weight) / power
    for k in unknown:
        u = _coordinates(terms)
        u[k] += 0.3 if u[k] < 0.3 else -0.3
        base = evidence.blocks[0].library.model.effects
        moved = evidence.mean(z, with_terms(_moved(terms, u), base), runs=runs, seed=seed + 5)
        delta = np.concatenate(moved) - here
        if np.isfinite(delta).all():
            found[:, k] = delta / (u[k] - _coordinates(terms)[k])
    return found


def _unknown(terms: Sequence[Term]) -> list[int]:
    """Return the coordinates of which the library has no signature."""
    found, k = [], 0
    for term in terms:
        for levels in term.signature.levels:
            if len(levels) < 2:
                found.append(k)
            k += 1
    return found


def _with_aliases(
    evidence: Evidence, terms: Sequence[Term], z: np.ndarray, slope_u: np.ndarray
) -> list[np.ndarray]:
    """Return the slopes to the tolerances; those that a coordinate shares, taken from it.

    The data cannot tell a severity from a tolerance of the same parameter; two estimates of one
    slope would pretend that they can.
    """
    names = [t.name for t in TOLERANCES]
    slopes = evidence.slopes(z)
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
                        1.0 + (u if term.variant.effect != "torque_constant_drop" else -u)
                    ) / (1.0 + width * value)
                    own[:, j] = factor * slope_u[at:at + len(slope), column]
                    spread = evidence.tolerances.spread(record, own)
                    used = np.flatnonzero(np.abs(spread).sum(axis=0))
                    slope[:, used] = spread[:, used]
                    at += len(slope)
            column += 1
    return slopes
