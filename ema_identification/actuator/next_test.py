"""Which test would tell apart what the data at hand cannot: predicted, not guessed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.features import feature_map
from ema_identification.actuator.fit import Fit
from ema_identification.actuator.inseparable import inseparable
from ema_identification.actuator.runs import Case, run_case
from ema_record.profile import Profile, load_profile
from ema_sim.simulate import simulate

PROFILES = ("extended", "ramps", "speeds", "steps", "deflections")
"""Shipped commands that may be proposed, the default test first."""
MOST = 3
"""Candidates that are compared."""
RUNS = 3
"""Runs of each candidate on each command."""
LEAST = 2.0
"""Separation below which a command promises nothing."""
ENOUGH = 20.0
"""Separation from which no further command is looked at."""


class Proposed(NamedTuple):
    """A test and how far it would set the candidates apart."""

    profile: Profile | None
    """None where only a measurement that is no command would do."""
    separation: float
    """Rms over the features that differ most, in standard deviations of a repeat."""
    text: str


def separating_test(evidence: Evidence, fits: Sequence[Fit], *, seed: int = 0) -> Proposed | None:
    """Return a command whose features would differ between the candidates.

    The first one that sets them `ENOUGH` apart, else the one that sets them farthest apart.

    Parameters
    ----------
    evidence : the records at hand; their commands are not proposed again.
    fits : candidates that cannot be told apart; the first `MOST` count.
    seed : of the runs.
    """
    one = inseparable(fits, evidence.blocks[0].library.model.effects)
    if one:
        return Proposed(None, 0.0, one)
    used = {tuple(b.record.profile.points) for b in evidence.blocks}
    best: Proposed | None = None
    fits = fits[:MOST]
    for name in PROFILES:
        if best is not None and best.separation >= ENOUGH:
            break
        profile = load_profile(name)
        if tuple(profile.points) in used:
            continue
        separation = _separation(profile, evidence, fits, seed)
        if best is None or separation > best.separation:
            names = " and ".join(dict.fromkeys(f.terms[-1].variant.effect for f in fits))
            best = Proposed(profile, separation, (
                f"run the profile {name!r} ({profile.description}): it would set {names} "
                f"{separation:.0f} standard deviations apart"))
    return best if best is not None and best.separation >= LEAST else None


def _separation(
    profile: Profile, evidence: Evidence, fits: Sequence[Fit], seed: int
) -> float:
    """Return the least separation of two candidates on a command."""
    block = evidence.blocks[0]
    model = block.library.model
    example = simulate(profile, actuator=model.actuator, seed=seed)
    fmap = feature_map(profile, model.actuator, example)
    runs = [
        np.array([
            run_case(model, Case(z=evidence.tolerances.of(0, fit.z), conditions=block.conditions,
                                 seed=seed + 1000 + RUNS * k + j,
                                 effects=fit.effects(model.effects)), fmap)
            for j in range(RUNS)
        ])
        for k, fit in enumerate(fits)
    ]
    spread = np.sqrt(np.mean([r.var(axis=0, ddof=1) for r in runs], axis=0))
    size = np.sqrt(np.mean([(r**2).mean(axis=0) for r in runs], axis=0))
    spread = np.maximum(spread, 2e-3 * size + 1e-6)
    least = np.inf
    for i in range(len(runs)):
        for j in range(i):
            apart = np.abs(runs[i].mean(axis=0) - runs[j].mean(axis=0)) / spread
            least = min(least, float(np.sqrt(np.mean(np.sort(apart)[-20:]**2))))
    return least
