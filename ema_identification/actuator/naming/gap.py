"""The gap on held-out data, and the test that would separate what is ambiguous.

Show: the gap on data that took no part in the fit, before and after.

The number is the root mean square of the largest tenth of the features' residuals, in standard
deviations of what the model may be off when nothing is missing: most effects show in few features,
and a mean over all would hide them. With held-out records the model is run on their commands.
Without, each tenth of the features is predicted from a fit to the other nine.

Effects that make one and the same machine: no command tells them apart.

A static eccentricity along the axis of a phase makes the constants of the three phases k (1 - ζ),
k (1 + ζ/2), k (1 + ζ/2): those of a machine whose k is 1 + ζ/2 times as large, with a short of
1.5 ζ / (1 + ζ/2) in that phase. The common factor lies within the tolerance of k, and what lies
across the axis within that of each phase. Only resistance and inductance tell a real short.

Which test would tell apart what the data at hand cannot: predicted, not guessed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.measure.features import feature_map
from ema_identification.actuator.measure.runs import Case, run_case
from ema_identification.actuator.measure.tolerances import SHARED, TOLERANCES
from ema_identification.actuator.surrogate.evidence import Asked, Evidence, noise_covariance, solve
from ema_identification.actuator.surrogate.fit import Fit
from ema_identification.actuator.surrogate.likelihood import Recalibration
from ema_record.profile import Profile, load_profile
from ema_sim.effects import Effects, rotor_eccentricity, turn_short
from ema_sim.effects.rotor_eccentricity import STATIC
from ema_sim.simulate import simulate

GAP_RUNS = 8
"""Runs of a held-out command."""
FOLDS = 10
"""Folds of the cross-validation; neighbouring features are in different ones."""
WORST = 0.1
"""Part of the features that the gap looks at."""
FLOOR = 2.2
"""The gap of a record against itself when nothing is missing; 2.1 for a normal distribution."""
DRAWS = 9
"""Runs of the model against itself that give the floor of a held-out command."""
LARGEST = 1e4
"""Most that one feature counts (standard deviations)."""


class Gap(NamedTuple):
    """A gap and where it comes from."""

    value: float
    floor: float
    residual: tuple[np.ndarray, ...]
    """Of each held-out record, in standard deviations."""


def _worst(parts: list[np.ndarray]) -> float:
    squares = np.sort(np.clip(np.concatenate(parts), -LARGEST, LARGEST)**2)
    return float(np.sqrt(np.mean(squares[-max(1, round(WORST * len(squares))):])))


def gap_of(
    evidence: Evidence, held: Evidence | None, fit: Fit | Recalibration,
    effects: Effects | None, *, seed: int,
) -> Gap:
    """Return the gap of a fitted model.

    Parameters
    ----------
    evidence : the records of the fit.
    held : held-out records; None predicts each tenth of the features from the
        others.
    fit : the fit.
    effects : of the model, None for its own.
    seed : of the runs on held-out records.
    """
    if held is None:
        parts = cross_validated(evidence, fit)
        return Gap(_worst(parts), FLOOR, tuple(parts))
    at = _Prediction(evidence, held, fit, effects, seed)
    parts = at.residual([b.values for b in held.blocks])
    return Gap(_worst(parts), at.floor(seed), tuple(parts))


class _Prediction:
    """Held-out records as predicted with the tolerances of the fit.

    What belongs to the day (the load) is fitted to the held-out record itself.
    """

    def __init__(
        self, evidence: Evidence, held: Evidence, fit: Fit | Recalibration,
        effects: Effects | None, seed: int,
    ) -> None:
        n = int(SHARED.sum())
        self.held, self.effects = held, effects
        self.z = np.zeros(held.tolerances.size)
        self.z[:n] = evidence.tolerances.of(0, fit.z)[SHARED]
        free = fit.free
        self.known = fit.covariance[free:free + n, free:free + n]
        self.mean = held.mean(self.z, effects, runs=GAP_RUNS, seed=seed + 100)

    def residual(self, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return measured minus predicted features in standard deviations, a record."""
        parts = []
        for k, block in enumerate(self.held.blocks):
            slope = block.library.null.slope(self.held.tolerances.of(k, self.z), block.conditions)
            variance = np.diag(noise_covariance(block, runs=GAP_RUNS)).copy()
            own, shared = slope[:, ~SHARED], slope[:, SHARED]
            variance += np.einsum("ij,jk,ik->i", shared, self.known, shared)
            root = np.sqrt(variance)
            residual = values[k] - self.mean[k]
            day, *_ = np.linalg.lstsq(
                np.vstack([own / root[:, None], np.eye(own.shape[1]) * np.sqrt(3.0)]),
                np.concatenate([residual / root, np.zeros(own.shape[1])]), rcond=None)
            parts.append((residual - own @ np.clip(day, -1.5, 1.5)) / root)
        return parts

    def floor(self, seed: int) -> float:
        """Return the gap of the model against itself.

        Its tolerances are drawn from what the fit leaves open, the noise is another. So the floor
        holds what the command at hand makes of a small error of the tolerances.
        """
        rng = np.random.default_rng([seed, 6])
        n = len(self.known)
        asked = []
        for k in range(DRAWS):
            z = self.z.copy()
            z[:n] = np.clip(rng.multivariate_normal(z[:n], self.known), -1.0, 1.0)
            z[n:] = rng.uniform(-1.0, 1.0, len(z) - n)
            asked.append(Asked(z, self.effects, 1, seed + 200 + k))
        found = [_worst(self.residual(values)) for values in self.held.means(asked)
                 if all(np.isfinite(f).all() for f in values)]
        return float(np.median(found)) if found else FLOOR


def cross_validated(evidence: Evidence, fit: Fit | Recalibration) -> list[np.ndarray]:
    """Return the residuals of each tenth of the features, predicted from a fit to the others."""
    if isinstance(fit, Fit):
        columns, centre = fit.slopes, fit.z
        residual = np.concatenate([b.values - f for b, f in zip(evidence.blocks, fit.mean)])
    else:
        columns, centre = np.vstack(evidence.slopes(fit.centre)), fit.centre
        residual = np.concatenate([b.values - f for b, f in zip(evidence.blocks, fit.mean)])
    noise = [noise_covariance(b, runs=fit.runs) for b in evidence.blocks]
    root = np.sqrt(np.concatenate([np.diag(c) for c in noise]))
    fold = np.arange(len(columns)) % FOLDS
    scaled, target = columns / root[:, None], residual / root
    found = np.empty(len(target))
    for k in range(FOLDS):
        inside = fold == k
        step, covariance, _ = solve(
            scaled[~inside], target[~inside], centre, fit.free, 0.0)
        rest = target[inside] - scaled[inside] @ step
        extra = np.einsum("ij,jk,ik->i", scaled[inside], covariance, scaled[inside])
        found[inside] = rest / np.sqrt(1.0 + extra)
    ends = np.cumsum([len(b) for b in evidence.blocks])
    return np.split(found, ends[:-1])


def whitened(evidence: Evidence, fit: Fit | Recalibration) -> list[np.ndarray]:
    """Return the residual of the fit in standard deviations, a record."""
    if isinstance(fit, Fit):
        means = list(fit.mean)
    else:
        means = [f + slope @ (fit.z - fit.centre)
                 for f, slope in zip(fit.mean, evidence.slopes(fit.centre))]
    return [(b.values - f) / np.sqrt(np.diag(noise_covariance(b, runs=fit.runs)))
            for b, f in zip(evidence.blocks, means)]


PHASES = "abc"
PAIR = {"turn_short", "rotor_eccentricity"}
WITHIN = next(t.half_width for t in TOLERANCES if t.name == "motor.back_emf_deviation_a")
"""Range of the ratio of two machines' constants, over the phases, that a unit may have anyway."""


def phase_constants(effects: Effects) -> np.ndarray:
    """Return the factors on the back-EMF constants of the phases, shape (3,)."""
    return np.array([
        turn_short.k_factor(effects.turn_short, k)
        * rotor_eccentricity.k_factor(effects.rotor_eccentricity, k, 0.0) for k in range(3)])


def inseparable(fits: Sequence[Fit], base: Effects) -> str:
    """Return why no command tells two fits apart, and what would; empty if one may.

    Parameters
    ----------
    fits : candidates that the data cannot tell apart.
    base : effects that the model has.
    """
    if len(fits) != 2 or {f.terms[-1].variant.effect for f in fits} != PAIR:
        return ""
    by_name = {f.terms[-1].variant.effect: f.effects(base) for f in fits}
    short, eccentric = by_name["turn_short"], by_name["rotor_eccentricity"]
    if eccentric.rotor_eccentricity.mode != STATIC:
        return ""
    ratio = phase_constants(eccentric) / phase_constants(short)
    if np.ptp(ratio) / ratio.mean() > WITHIN:
        return ""
    phase, part = PHASES[short.turn_short.phase], 100.0 * short.turn_short.fraction
    return (
        "measure the resistance of the three phases at standstill (a short makes that of phase "
        f"{phase} {part:.1f} % lower than the others'); no test tells turn_short of phase {phase} "
        "and rotor_eccentricity along its axis apart, both change the same constants"
    )


PROFILES = ("extended", "ramps", "speeds", "steps", "deflections")
"""Shipped commands that may be proposed, the default test first."""
MOST = 3
"""Candidates that are compared."""
TEST_RUNS = 3
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
                                 seed=seed + 1000 + TEST_RUNS * k + j,
                                 effects=fit.effects(model.effects)), fmap)
            for j in range(TEST_RUNS)
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
