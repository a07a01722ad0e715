"""Build the library of a test: fleet, repeats, laws; then judge it on units that built nothing.

The units set aside give the two things that the decision stands on: what healthy units leave, for
ranks, and how far the likelihood's scale is off, which is then put right.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from ema_identification.actuator.decision.fit import LawFit, TestedUnit
from ema_identification.actuator.decision.fleet import (
    SIZE,
    draw_fleet_conditions,
    draw_fleet_unit,
    fleet_features,
)
from ema_identification.actuator.decision.proposals import linear_gains, selectable
from ema_identification.actuator.decision.surrogate import (
    FleetLibrary,
    arguments,
    fit_mean,
    noise_law,
)
from ema_identification.actuator.measure.features import FeatureMap, feature_map
from ema_identification.actuator.measure.runs import Progress, silent, spread_out
from ema_identification.actuator.measure.tolerances import RecordConditions
from ema_identification.actuator.surrogate.library import Signature
from ema_identification.actuator.surrogate.library_runs import (
    FLOOR,
    FLOORS,
    build_effect_library,
    candidates,
    pack,
    unpack,
)
from ema_record import array_cache as cache
from ema_record.kit import LIBRARY, kit_path
from ema_record.profile import Profile
from ema_record.spread import TypeSpread, load_spread
from ema_sim.model_file import Model
from ema_sim.simulate import simulate


class LibrarySizes(NamedTuple):
    """How many runs a library is made of."""

    units: int = 3000
    repeated: int = 450
    set_aside: int = 400
    """For two scores they resolve a level of 1 in 200."""
    scaled: int = 40
    """Of those, units that set the scale of the likelihood, on the quadratic and on runs."""


FULL = LibrarySizes()
CHUNK = 20
SETTLED_RUNS = 8
"""Of a model in the end, healthy or not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetRuns:
    """Runs of healthy units.

    Attributes
    ----------
    z : ndarray, shape (n, SIZE).
    conditions : ndarray, shape (n, 4). Temperature, bus, noise, start angle.
    features : ndarray, shape (n, d).
    again : ndarray, shape (m, d). Second runs of the first m units.
    """

    z: np.ndarray
    conditions: np.ndarray
    features: np.ndarray
    again: np.ndarray


def conditions_of(row: np.ndarray) -> RecordConditions:
    """Return the conditions of a row of `FleetRuns.conditions`."""
    temperature, bus, noise, angle = map(float, row)
    return RecordConditions(temperature=temperature, bus=bus, noise=noise, start_angle=angle,
                            measured=frozenset({"temperature", "bus"}))


def _chunk(model: Model, spread: TypeSpread, fmap: FeatureMap, seed: int, first: int, last: int,
           repeated: int) -> np.ndarray:
    from threadpoolctl import threadpool_limits

    rows = []
    with threadpool_limits(limits=1):
        for k in range(first, last):
            rng = np.random.default_rng([seed, 7, k])  # the same unit in every test
            z, c = draw_fleet_unit(rng), draw_fleet_conditions(rng, spread)
            seeds = rng.integers(2**31, size=2)
            found = fleet_features(model, spread, fmap, z, c, int(seeds[0]))
            again = fleet_features(model, spread, fmap, z, c, int(seeds[1])) if (
                k < repeated) else np.full(len(found), np.nan)
            rows.append(np.concatenate([
                z, [c.temperature, c.bus, c.noise, c.start_angle], found, again]))
    return np.array(rows)


def fleet_runs(
    model: Model, spread: TypeSpread, fmap: FeatureMap, sizes: LibrarySizes, *, seed: int = 0,
    workers: int = 1, progress: Progress = silent,
) -> FleetRuns:
    """Simulate the healthy units; the last `set_aside` are for judging."""
    n, d = sizes.units + sizes.set_aside, len(fmap.features)
    rows = np.concatenate(spread_out(
        partial(_chunk, model, spread, fmap, seed),
        [(k, min(k + CHUNK, n), sizes.repeated) for k in range(0, n, CHUNK)],
        workers=workers, progress=progress, what="healthy units"))
    return FleetRuns(z=rows[:, :SIZE], conditions=rows[:, SIZE:SIZE + 4],
                     features=rows[:, SIZE + 4:SIZE + 4 + d],
                     again=rows[:sizes.repeated, SIZE + 4 + d:])


def fitted_library(
    runs: FleetRuns, model: Model, spread: TypeSpread, fmap: FeatureMap, sizes: LibrarySizes,
    signatures: tuple[Signature, ...] = (),
) -> FleetLibrary:
    """Return the library of runs, not judged yet."""
    good = np.isfinite(runs.features).all(axis=1)
    good[sizes.units:] = False
    v = np.array([arguments(z, conditions_of(c))
                  for z, c in zip(runs.z[good], runs.conditions[good])])
    features, noise = runs.features[good], runs.conditions[good, 2]
    floor = (FLOOR * np.sqrt((features**2).mean(axis=0)) + 1e-6) ** 2
    for k, feature in enumerate(fmap.features):
        floor[k] = max(floor[k], FLOORS.get(feature.name, 0.0) ** 2)
    weights, rest = fit_mean(v, features)
    paired = np.isfinite(runs.again).all(axis=1) & good[:len(runs.again)]
    difference = (runs.features[:len(runs.again)] - runs.again)[paired] / np.sqrt(2.0)
    return FleetLibrary(
        model=model, spread=spread, fmap=fmap, weights=weights, signatures=signatures,
        surrogate=noise_law(rest, noise, floor),
        repeat=noise_law(difference, runs.conditions[:len(runs.again)][paired, 2], 0.5 * floor),
        healthy=np.ones((1, 2)),
        aside=(runs.conditions[sizes.units:], runs.features[sizes.units:]))


def judged_library(
    library: FleetLibrary, runs: FleetRuns, sizes: LibrarySizes, *, progress: Progress = silent,
) -> FleetLibrary:
    """Return the library put to scale, with what units that built nothing of it leave.

    The likelihood on runs is put to the same scale as that on the quadratic, so that one list of
    healthy scores serves both.
    """
    units = [
        TestedUnit(library=library, values=runs.features[k], seed=k,
                   conditions=conditions_of(runs.conditions[k]))
        for k in range(sizes.units, len(runs.z)) if np.isfinite(runs.features[k]).all()]
    some = [unit.without_law().cost / unit.size for unit in units[:sizes.scaled]]
    library = replace(library, surrogate=library.surrogate.scaled(float(np.mean(some))))
    units = [replace(unit, library=library) for unit in units]
    healthy = []
    for k, unit in enumerate(units):
        healthy.append(scores(unit, unit.without_law(), 0))
        progress("units set aside", (k + 1) / len(units))
    first = [(u, u.settled(u.without_law(), None, 3, salt=3)) for u in units[:sizes.scaled]]
    means = [(u, fit, u.run((), fit.z, SETTLED_RUNS, salt=4)) for u, fit in first]
    return replace(library, healthy=np.array(healthy), carried=_carried(library, means))


def paired_units(
    held: FleetLibrary, fitted: FleetLibrary
) -> list[tuple[TestedUnit, TestedUnit]]:
    """Return the units set aside, each in both tests: they are the same ones in every test."""
    def units(library: FleetLibrary) -> list[TestedUnit]:
        return [TestedUnit(library=library, values=values, conditions=conditions_of(row))
                for row, values in zip(*library.aside)]

    return [(a, b) for a, b in zip(units(held), units(fitted))
            if np.isfinite(a.values).all() and np.isfinite(b.values).all()]


def _carried(
    library: FleetLibrary, means: Sequence[tuple[TestedUnit, LawFit, np.ndarray]]
) -> float:
    """Return the share at which settled units leave a cost of 1 a feature."""
    def excess(share: float) -> float:
        costs = []
        for unit, fit, mean in means:
            at = replace(unit, library=replace(library, carried=share))
            costs.append(at.settled_at(fit, mean, at.whitener(SETTLED_RUNS), SETTLED_RUNS).cost
                         / at.size)
        return float(np.mean(costs)) - 1.0

    if excess(0.0) <= 0.0:
        return 0.0
    return float(brentq(excess, 0.0, 2.0, xtol=0.02)) if excess(2.0) < 0.0 else 2.0


def scores(unit: TestedUnit, fit: LawFit, runs: int) -> tuple[float, float]:
    """Return cost a feature, and the largest gain of a law in units of what it leaves."""
    found = linear_gains(unit, fit, unit.whitener(runs), selectable(unit, ()))
    lower = found[0].cost if found else fit.cost
    return fit.cost / unit.size, gain_of(fit.cost, lower, unit.size)


def gain_of(cost: float, lower: float, size: int) -> float:
    """Return a fall of the cost in units of what is left a feature."""
    return (cost - lower) / max(lower / size, 1e-9)


def fleet_library(
    model: Model, profile: Profile, *, rate: float | None = None, signatures: bool = True,
    sizes: LibrarySizes = FULL, seed: int = 0, workers: int = 1, progress: Progress = silent,
) -> FleetLibrary:
    """Return the library of a model, a test and a rate, from the kit or the cache, else built."""
    spread = load_spread()
    rate = model.actuator.acquisition.rate if rate is None else rate
    example = simulate(profile, actuator=model.actuator, effects=model.effects, seed=seed,
                       rate=rate)
    fmap = feature_map(profile, model.actuator, example)
    command = [list(p) for p in profile.points]
    key = cache.key_of(
        json.dumps([command, profile.inverter_off, rate, list(sizes), signatures]), repr(model),
        repr(spread), str(seed), module=__name__)

    def kept(what: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        found = cache.load(f"{what}_{key}", kit_path(LIBRARY)) or cache.load(f"{what}_{key}")
        if found is None:
            found = make()
            cache.save(f"{what}_{key}", found, None)
        return found

    runs = FleetRuns(**kept("fleet", lambda: asdict(fleet_runs(
        model, spread, fmap, sizes, seed=seed, workers=workers, progress=progress))))
    laws = unpack(candidates(model), kept("laws", lambda: {"added": pack(build_effect_library(
        model, fmap, seed=seed, workers=workers, progress=progress))})["added"]
    ) if signatures else ()
    plain = fitted_library(runs, model, spread, fmap, sizes, laws)

    def judged() -> dict[str, np.ndarray]:
        found = judged_library(plain, runs, sizes, progress=progress)
        return {"healthy": found.healthy, "scale": np.array(
            [found.carried, float(found.surrogate.quiet[0] / plain.surrogate.quiet[0])])}

    found = kept("judged", judged)
    return replace(plain, healthy=found["healthy"], carried=float(found["scale"][0]),
                   surrogate=plain.surrogate.scaled(float(found["scale"][1])))
