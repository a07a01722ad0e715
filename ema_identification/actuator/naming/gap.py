"""The gap on held-out data, and the test that would separate what is ambiguous.

Show: the gap of the model as given and after each effect, and what noise alone leaves.

The number is the root mean square of a tenth of the features' residuals: most effects show in few
features, and a mean over all would hide them. The yardstick is fixed before anything is added: the
standard deviation of each feature when nothing is missing, as the recalibrated model as given has
it. The features are the same for all models that are compared: those in which the worst of them is
off most. With held-out records the models are run on their commands; they take no part in any
fit and decide no name. Without, the numbers are those of the fitted records.

What noise alone leaves is found by putting runs of the last model in the place of the measurement;
for held-out records its parameters are drawn from what the fit leaves open.

Effects that make one and the same machine: no command tells them apart.

A static eccentricity along the axis of a phase makes the constants of the three phases k (1 - ζ),
k (1 + ζ/2), k (1 + ζ/2): those of a machine whose k is 1 + ζ/2 times as large, with a short of
1.5 ζ / (1 + ζ/2) in that phase. The common factor lies within the tolerance of k, and what lies
across the axis within that of each phase. Only resistance and inductance tell a real short.

Which test would tell apart what the data at hand cannot: predicted, not guessed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.measure.features import feature_map
from ema_identification.actuator.measure.runs import UnitRun, run_case
from ema_identification.actuator.measure.tolerances import SHARED, TOLERANCES
from ema_identification.actuator.surrogate.evidence import Asked, Evidence, noise_covariance, solve
from ema_identification.actuator.surrogate.fit import Fit, coordinates, moved, with_terms
from ema_identification.actuator.surrogate.likelihood import Recalibration
from ema_record.profile import Profile, load_profile
from ema_sim.effects import Effects, rotor_eccentricity, turn_short
from ema_sim.effects.rotor_eccentricity import STATIC
from ema_sim.simulate import simulate

GAP_RUNS = 8
"""Runs of a model on a held-out command."""
WORST = 0.1
"""Part of the features that the gap looks at."""
DRAWS = 39
"""Runs in place of the measurement: the least number whose rank tells a level of 0.025."""
LEVEL = 0.05
"""Probability by noise alone from which a gap is more than noise."""
LARGEST_RESIDUAL = 1e4
"""Most that one feature counts (standard deviations)."""
DAY = 1.5
"""Largest deviation of the day (the load) that is fitted to a held-out record (half widths)."""

Model = Fit | Recalibration


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelGap:
    """The gap of the model as given and after each effect, in the order found.

    Attributes
    ----------
    values : of the model as given first.
    draws : ndarray, shape (n, models). The same numbers where runs of the last model stand in the
        place of the measurement.
    residual : of each model, of each record: ndarray, shape (d,), standard deviations.
    held : whether the records took no part in the fit.
    """

    values: tuple[float, ...]
    draws: np.ndarray
    residual: tuple[tuple[np.ndarray, ...], ...]
    held: bool

    @property
    def floor(self) -> float:
        """What noise alone leaves: the median of the draws."""
        return float(np.median(self.draws[:, -1])) if len(self.draws) else float("nan")

    @property
    def p_value(self) -> float:
        """Probability that noise alone leaves as much as the last model: its rank."""
        return _rank(self.values[-1], self.draws[:, -1])

    @property
    def contradicts(self) -> bool:
        """Whether held-out records speak against the last model.

        Their gap grew, by more than it does where the last model is right, to more than noise
        leaves.
        """
        growth = self.values[-1] / self.values[0]
        usual = self.draws[:, -1] / self.draws[:, 0]
        return (self.held and growth > 1.0 and self.p_value <= LEVEL
                and _rank(growth, usual) <= LEVEL)


def _rank(value: float, draws: np.ndarray) -> float:
    """Return the probability of a value as large, by its rank among draws."""
    return float(1 + np.sum(draws >= value)) / (1 + len(draws))


def gap_of(
    evidence: Evidence, held: Evidence | None, null: Recalibration, fits: Sequence[Fit], *,
    seed: int,
) -> ModelGap:
    """Return the gap of the model as given and of fits that add one effect after another.

    Parameters
    ----------
    evidence : the records of the fit.
    held : held-out records; None shows the gap on those of the fit.
    null : the recalibrated model as given; it gives the yardstick.
    fits : after each effect, in the order found.
    seed : of the runs.
    """
    models: list[Model] = [null, *fits]
    shown = _Fitted(evidence, null) if held is None else _HeldOut(evidence, held, null)
    measured = [b.values for b in shown.evidence.blocks]
    means = [shown.predicted(m, seed) for m in models]

    def left(values: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
        return [shown.residual(m, mean, values) for m, mean in zip(models, means)]

    residual = left(measured)
    draws = [worst(left(values)) for values in shown.evidence.means(shown.asked(models[-1], seed))
             if all(np.isfinite(f).all() for f in values)]
    return ModelGap(values=tuple(worst(residual)), held=held is not None,
               draws=np.array(draws).reshape(-1, len(models)),
               residual=tuple(tuple(r) for r in residual))


def worst(residual: Sequence[Sequence[np.ndarray]]) -> list[float]:
    """Return the rms of each model over the tenth of features in which the worst is off most."""
    squares = np.array([np.clip(np.concatenate(list(r)), -LARGEST_RESIDUAL, LARGEST_RESIDUAL)**2
                        for r in residual])
    count = max(1, round(WORST * squares.shape[1]))
    chosen = np.argsort(squares.max(axis=0))[-count:]
    return [float(np.sqrt(row[chosen].mean())) for row in squares]


class _Fitted:
    """The gap on the records of the fit: residuals after a last linear step of all unknowns."""

    def __init__(self, evidence: Evidence, null: Recalibration) -> None:
        self.evidence = evidence
        self._root = np.sqrt(np.concatenate([
            np.diag(noise_covariance(b, runs=null.runs)) for b in evidence.blocks]))
        self._ends = np.cumsum([len(b) for b in evidence.blocks])[:-1]

    def predicted(self, model: Model, _seed: int) -> list[np.ndarray]:
        return list(model.mean)

    def residual(
        self, model: Model, mean: Sequence[np.ndarray], values: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        target = np.concatenate([v - f for v, f in zip(values, mean)]) / self._root
        slopes, z = (model.slopes, model.z) if isinstance(model, Fit) else (
            np.vstack(self.evidence.slopes(model.centre)), model.centre)
        columns = slopes / self._root[:, None]
        step, *_ = solve(columns, target, z, model.free, 0.0)
        return np.split(target - columns @ step, self._ends)

    def asked(self, model: Model, seed: int) -> list[Asked]:
        effects = model.effects(self.evidence.blocks[0].library.model.effects) if isinstance(
            model, Fit) else None
        z = np.clip(model.z, -1.0, 1.0)
        return [Asked(z, effects, 1, seed + 200 + k) for k in range(DRAWS)]


class _HeldOut:
    """The gap on held-out records, predicted with the tolerances of the fit.

    What belongs to the day (the load) is fitted to the held-out record itself.
    """

    def __init__(self, evidence: Evidence, held: Evidence, null: Recalibration) -> None:
        self.evidence, self._fitted = held, evidence
        n = int(SHARED.sum())
        z, known = self._tolerances(null), null.covariance[:n, :n]
        self._roots, self._days = [], []
        for k, block in enumerate(held.blocks):
            slope = block.library.null.slope(held.tolerances.of(k, z), block.conditions)
            own, shared = slope[:, ~SHARED], slope[:, SHARED]
            variance = np.diag(noise_covariance(block, runs=GAP_RUNS)) + np.einsum(
                "ij,jk,ik->i", shared, known, shared)
            self._roots.append(np.sqrt(variance))
            self._days.append(own / np.sqrt(variance)[:, None])

    def _tolerances(self, model: Model) -> np.ndarray:
        z = np.zeros(self.evidence.tolerances.size)
        z[:int(SHARED.sum())] = self._fitted.tolerances.of(0, model.z)[SHARED]
        return z

    def predicted(self, model: Model, seed: int) -> list[np.ndarray]:
        base = self.evidence.blocks[0].library.model.effects
        effects = model.effects(base) if isinstance(model, Fit) else base
        return self.evidence.mean(
            self._tolerances(model), effects, runs=GAP_RUNS, seed=seed + 100)

    def residual(
        self, _model: Model, mean: Sequence[np.ndarray], values: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        parts = []
        for root, own, v, f in zip(self._roots, self._days, values, mean):
            target = (v - f) / root
            weight = np.sqrt(3.0) * np.eye(own.shape[1])  # of the load's uniform band
            day, *_ = np.linalg.lstsq(
                np.vstack([own, weight]), np.append(target, np.zeros(own.shape[1])), rcond=None)
            parts.append(target - own @ np.clip(day, -DAY, DAY))
        return parts

    def asked(self, model: Model, seed: int) -> list[Asked]:
        """Return runs with effects and tolerances drawn from what the fit leaves open."""
        rng = np.random.default_rng([seed, 6])
        terms = model.terms if isinstance(model, Fit) else ()
        u = coordinates(terms) if terms else np.zeros(0)
        base, n = self.evidence.blocks[0].library.model.effects, int(SHARED.sum())
        z, size = self._tolerances(model), len(u) + int(SHARED.sum())
        found = []
        for k in range(DRAWS):
            drawn = rng.multivariate_normal(np.append(u, z[:n]), model.covariance[:size, :size])
            there = np.append(np.clip(drawn[len(u):], -1.0, 1.0),
                              rng.uniform(-1.0, 1.0, len(z) - n))
            effects = with_terms(moved(terms, drawn[:len(u)]), base)
            found.append(Asked(there, effects, 1, seed + 200 + k))
        return found


def whitened(evidence: Evidence, fit: Model) -> list[np.ndarray]:
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


def separating_test(evidence: Evidence, fits: Sequence[Fit], *, seed: int = 0) -> Proposed | None:
    """Return a command whose features would differ between the candidates.

    The first one that sets them `ENOUGH_SEPARATION` apart, else the one that does so most.

    Parameters
    ----------
    evidence : the records at hand; their commands are not proposed again.
    fits : candidates that cannot be told apart; the first `COMPARED` count.
    seed : of the runs.
    """
    one = inseparable(fits, evidence.blocks[0].library.model.effects)
    if one:
        return Proposed(None, 0.0, one)
    used = {tuple(b.record.profile.points) for b in evidence.blocks}
    best: Proposed | None = None
    fits = fits[:COMPARED]
    for name in PROFILES:
        if best is not None and best.separation >= ENOUGH_SEPARATION:
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
    return best if best is not None and best.separation >= LEAST_SEPARATION else None


def _separation(
    profile: Profile, evidence: Evidence, fits: Sequence[Fit], seed: int
) -> float:
    """Return the least separation of two candidates on a command."""
    block = evidence.blocks[0]
    model = block.library.model
    example = simulate(profile, actuator=model.actuator, seed=seed,
                       rate=block.library.fmap.rate)
    fmap = feature_map(profile, model.actuator, example)
    runs = [
        np.array([
            run_case(model, UnitRun(
                z=evidence.tolerances.of(0, fit.z), conditions=block.conditions,
                seed=seed + 1000 + TEST_RUNS * k + j, effects=fit.effects(model.effects)), fmap)
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
