"""Which test would tell apart what the data at hand cannot: predicted, not guessed.

Candidates are simulated on the shipped commands; the one whose features differ most is proposed.

Some effects make one and the same machine, and no command tells them apart. A static eccentricity
along the axis of a phase makes the constants of the three phases k (1 - ζ), k (1 + ζ/2),
k (1 + ζ/2): those of a machine whose k is 1 + ζ/2 times as large, with a short of
1.5 ζ / (1 + ζ/2) in that phase. The common factor lies within the tolerance of k, and what lies
across the axis within that of each phase. Only resistance and inductance tell a real short.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.laws.terms import LawFit, with_terms
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
    phase, part = PHASES[short.turn_short.phase], 100.0 * short.turn_short.fraction
    return (
        "measure the resistance of the three phases at standstill (a short makes that of phase "
        f"{phase} {part:.1f} % lower than the others'); no test tells turn_short of phase {phase} "
        "and rotor_eccentricity along its axis apart, both change the same constants"
    )


PROFILES = ("extended", "ramps", "speeds", "steps", "deflections")
"""Commands that may be proposed where the kit has them, the default test first."""
COMPARED = 3
"""Candidates that are compared."""
TEST_RUNS = 3
"""Runs of each candidate on each command."""
LEAST_SEPARATION = 2.0
"""Separation below which a command promises nothing."""
ENOUGH_SEPARATION = 20.0
"""Separation from which no further command is looked at."""


class Proposed(NamedTuple):
    """A test and how far it would set the candidates apart."""

    profile: Profile | None
    """None where only a measurement that is no command would do."""
    separation: float
    """Rms over the features that differ most, in standard deviations of a repeat."""
    text: str


def separating_test(unit: TestedUnit, fits: Sequence[LawFit], *, seed: int = 0) -> Proposed | None:
    """Return a command whose features would differ between the candidates.

    The first one that sets them `ENOUGH_SEPARATION` apart, else the one that does so most.

    Parameters
    ----------
    unit : the records at hand; their commands are not proposed again.
    fits : candidates that cannot be told apart; the first `COMPARED` count.
    seed : of the runs.
    """
    base = unit.library.model.effects
    one = inseparable({f.names[-1]: with_terms(f.terms, base) for f in fits})
    if one:
        return Proposed(None, 0.0, one)
    used = {tuple(part.library.fmap.profile.points) for part in unit.parts}
    best: Proposed | None = None
    fits = fits[:COMPARED]
    for name in (name for name in PROFILES if name in profile_names()):
        if best is not None and best.separation >= ENOUGH_SEPARATION:
            break
        profile = load_profile(name)
        if tuple(profile.points) in used:
            continue
        separation = _separation(profile, unit, fits, seed)
        if best is None or separation > best.separation:
            common = set.intersection(*(set(f.names) for f in fits))
            names = " and ".join(dict.fromkeys(
                n for f in fits for n in f.names if n not in common))
            best = Proposed(profile, separation, (
                f"run the profile {name!r} ({profile.description}): it would set {names} "
                f"{separation:.0f} standard deviations apart"))
    return best if best is not None and best.separation >= LEAST_SEPARATION else None


def _separation(
    profile: Profile, unit: TestedUnit, fits: Sequence[LawFit], seed: int
) -> float:
    """Return the least separation of two candidates on a command."""
    library, rng = unit.library, np.random.default_rng([seed, 47])
    model = library.model
    example = whole(simulate(profile, actuator=model.actuator, seed=seed,
                             rate=library.fmap.rate), model.actuator)
    fmap = feature_map(profile, model.actuator, example)
    runs = [
        np.array([
            unit.simulator(model, library.spread, fmap, fit.z[:library.width], unit.conditions,
                           int(s), with_terms(fit.terms, model.effects))
            for s in rng.integers(2**31, size=TEST_RUNS)])
        for fit in fits]
    spread = np.sqrt(np.mean([r.var(axis=0, ddof=1) for r in runs], axis=0))
    size = np.sqrt(np.mean([(r**2).mean(axis=0) for r in runs], axis=0))
    spread = np.maximum(spread, 2e-3 * size + 1e-6)
    least = np.inf
    for i in range(len(runs)):
        for j in range(i):
            apart = np.abs(runs[i].mean(axis=0) - runs[j].mean(axis=0)) / spread
            least = min(least, float(np.sqrt(np.mean(np.sort(apart)[-20:]**2))))
    return least
