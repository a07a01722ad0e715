"""Which test would tell apart what the data at hand cannot: predicted, not guessed.

Candidates are simulated on the shipped commands, each all over what the records at hand leave it;
the command that sets them apart whatever they are is proposed.

Some effects make one and the same machine, and no command tells them apart. A static eccentricity
along the axis of a phase makes the constants of the three phases k (1 - ζ), k (1 + ζ/2),
k (1 + ζ/2): those of a machine whose k is 1 + ζ/2 times as large, with a short of
1.5 ζ / (1 + ζ/2) in that phase. The common factor lies within the tolerance of k, and what lies
across the axis within that of each phase. Only resistance and inductance tell a real short.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.intervals import at, posterior_of
from ema_identification.actuator.fleet.surrogate import shrunk
from ema_identification.actuator.laws.terms import SURE, LawFit, bounds, with_terms
from ema_identification.actuator.measure.features import feature_map
from ema_identification.actuator.measure.recorder import whole
from ema_record.profile import Profile, load_profile, profile_names
from ema_record.spread import load_spread
from ema_sim.effects import Effects, rotor_eccentricity, turn_short
from ema_sim.effects.rotor_eccentricity import STATIC
from ema_sim.simulate import simulate

PHASES = "abc"
PAIR = {"turn_short", "rotor_eccentricity"}


def phase_constants(effects: Effects) -> np.ndarray:
    """Return the factors on the back-EMF constants of the phases, shape (3,)."""
    return np.array([
        turn_short.k_factor(effects.turn_short, k)
        * rotor_eccentricity.k_factor(effects.rotor_eccentricity, k, 0.0) for k in range(3)])


def inseparable(by_name: Mapping[str, Effects]) -> str:
    """Return why no command tells two machines apart, and what would; empty if one may.

    `by_name` : effects of each candidate by its name.
    """
    if set(by_name) != PAIR:
        return ""
    short, eccentric = by_name["turn_short"], by_name["rotor_eccentricity"]
    if eccentric.rotor_eccentricity.mode != STATIC:
        return ""
    ratio = phase_constants(eccentric) / phase_constants(short)
    if np.ptp(ratio) / ratio.mean() > load_spread().tolerances.back_emf_phase:
        return ""
    return (f"{_resistances(short)}; no test tells turn_short and rotor_eccentricity along the "
            "axis of its phase apart, both change the same constants")


def _resistances(short: Effects) -> str:
    phase, part = PHASES[short.turn_short.phase], 100.0 * short.turn_short.fraction
    return ("measure the resistance of the three phases at standstill (a short makes that of "
            f"phase {phase} {part:.1f} % lower than the others')")


PROFILES = ("extended", "ramps", "speeds", "steps", "deflections")
"""Commands that may be proposed where the kit has them, the default test first."""
COMPARED = 3
"""Candidates that are compared."""
FOLDS = 6
"""One run in so many judges the direction that the others chose."""
TEST_RUNS = 8 * FOLDS
"""Budget: runs of each candidate on each command."""


class Proposed(NamedTuple):
    """A test and how far it would set the candidates apart."""

    profile: Profile | None
    """None where only a measurement that is no command would do."""
    separation: float
    """Between the two that are nearest, in standard deviations of what each may do there."""
    text: str


def separating_test(unit: TestedUnit, fits: Sequence[LawFit]) -> Proposed | None:
    """Return a command whose features would differ between the candidates, whatever each may be.

    The first one that does surely, else the one that does most, if it is likely to leave one name;
    a measurement at standstill in its place, where there is one.

    Parameters
    ----------
    unit : the records at hand; their commands are not proposed again.
    fits : candidates that cannot be told apart; the first `COMPARED` count.
    """
    common = set.intersection(*(set(f.names) for f in fits))
    by_name = {name: with_terms(f.terms, unit.library.model.effects)
               for f in fits for name in f.names if name not in common}
    if one := inseparable(by_name):
        return Proposed(None, 0.0, one)
    used = {tuple(part.library.fmap.profile.points) for part in unit.parts}
    best: Proposed | None = None
    fits = fits[:COMPARED]
    likely, sure = separations_needed(unit)
    for name in (name for name in PROFILES if name in profile_names()):
        if best is not None and best.separation >= sure:
            break
        profile = load_profile(name)
        if tuple(profile.points) in used:
            continue
        separation = _separation(profile, unit, fits)
        if best is None or separation > best.separation:
            best = Proposed(profile, separation, (
                f"run the profile {name!r} ({profile.description}): it would set "
                f"{' and '.join(by_name)} {separation:.0f} standard deviations apart"))
    if best is not None and best.separation < likely:
        return Proposed(None, best.separation, (
            f"{_resistances(by_name['turn_short'])}; no test of the kit is likely to tell "
            "turn_short and rotor_eccentricity apart")) if set(by_name) == PAIR else None
    return best


def separations_needed(unit: TestedUnit) -> tuple[float, float]:
    """Return the separations from which one name is left: as likely as not, and with `SURE`.

    Of candidates that are s deviations apart the one that is not true leaves s² more in the mean,
    2 s its deviation; in the evidence ν of d features count. One name has `SURE` of the evidence
    from L² = 2 (d / ν) ln(SURE / (1 - SURE)) on.
    """
    per_number = unit.size / unit.library.freedom
    likely = float(np.sqrt(2.0 * per_number * np.log(SURE / (1.0 - SURE))))
    z = float(norm.ppf(SURE))
    return likely, float(z + np.hypot(z, likely))


def _separation(profile: Profile, unit: TestedUnit, fits: Sequence[LawFit]) -> float:
    """Return the least separation of two candidates on a command, 0 where one seldom can run it.

    Each is run all over what the records at hand leave it, on any day.
    """
    library, part = unit.library, unit.parts[0]
    example = whole(simulate(profile, actuator=library.model.actuator, seed=unit.seed,
                             rate=library.fmap.rate), library.model.actuator)
    there = TestedUnit(  # also of a unit beside its accepted records, which are of another test
        values=part.values, conditions=part.conditions, seed=unit.seed, workers=part.workers,
        simulator=part.simulator, library=replace(
            library, fmap=feature_map(profile, library.model.actuator, example), left=None))
    rng = np.random.default_rng([unit.seed, 47])
    runs = [np.array(there.run_all([(f.terms, f.z) for f in _drawn(unit, fit, rng)], 1,
                                   salt=47 + k, apart=True)) for k, fit in enumerate(fits)]
    samples = [rows[np.isfinite(rows).all(axis=1)] for rows in runs]  # what can be simulated
    if min(map(len, samples)) < TEST_RUNS // 2:
        return 0.0
    return min(separation_of(*pair) for pair in combinations(samples, 2))


def _drawn(unit: TestedUnit, fit: LawFit, rng: np.random.Generator) -> list[LawFit]:
    """Return models of all that the records leave a fit, of some day, one for each run."""
    known, width = posterior_of(unit, fit), unit.library.width
    low, high = (np.append(end, np.full(width, side) * unit.edge)
                 for end, side in zip(bounds(fit.terms), (-1.0, 1.0)))
    points = rng.multivariate_normal(  # a law without slope here may be anything
        known.mean, known.covariance, TEST_RUNS, method="eigh", check_valid="ignore")
    points = np.clip(points[:, :fit.free + width], low, high)
    day = fit.free + np.flatnonzero(unit.library.of_day)
    points[:, day] = rng.uniform(-1.0, 1.0, (TEST_RUNS, len(day)))
    return [at(fit, x) for x in points]


def separation_of(one: np.ndarray, other: np.ndarray) -> float:
    """Return how far two samples, (n, d) each, are apart, in deviations along one direction.

    The best one (Fisher 1936, covariance of Ledoit and Wolf 2004) of all but every `FOLDS`-th row,
    which judge it: with rows so few it is less than that of many (of 1000 independent features,
    12 deviations apart, 48 rows tell 10), never more in the mean.
    """
    judged: tuple[list[np.ndarray], list[np.ndarray]] = [], []
    for k in range(FOLDS):
        rows = [np.delete(x, np.s_[k::FOLDS], axis=0) for x in (one, other)]
        here, there = (x.mean(axis=0) for x in rows)
        rest = np.vstack([rows[0] - here, rows[1] - there])
        size = np.sqrt(0.5 * (here**2 + there**2))
        scale = np.sqrt((rest**2).mean(axis=0)) + 2e-3 * size + 1e-6  # some are constant
        covariance, share = shrunk(rest / scale)
        covariance[np.diag_indices_from(covariance)] += share
        way = np.linalg.solve(covariance, (there - here) / scale) / scale
        way /= way @ (there - here)
        for found, x in zip(judged, (one, other)):
            found.append((x[k::FOLDS] - 0.5 * (here + there)) @ way)
    a, b = map(np.concatenate, judged)
    return float(max((b.mean() - a.mean()) / np.sqrt(0.5 * (a.var() + b.var())), 0.0))
