"""Build the library of a test: fleet, repeats, laws; then judge it on units that built nothing.

The units set aside give the two things that the decision stands on: what healthy units leave, for
ranks, and how far the likelihood's scale is off, which is then put right.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.fleet import (
    FULL,
    FleetRuns,
    LibrarySizes,
    conditions_of,
    fleet_runs,
)
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.decision.surrogate import (
    SETTLED_RUNS,
    FleetLibrary,
    NoiseLaw,
    arguments,
    fit_mean,
    noise_law,
)
from ema_identification.actuator.laws.catalogue import Signature
from ema_identification.actuator.laws.signatures import (
    build_effect_library,
    candidates,
    pack,
    unpack,
)
from ema_identification.actuator.laws.terms import LawFit
from ema_identification.actuator.measure.features import FeatureMap, feature_map
from ema_identification.actuator.measure.recorder import whole
from ema_identification.actuator.measure.runs import Progress, silent
from ema_record import array_cache as cache
from ema_record.kit import LIBRARY, kit_path
from ema_record.profile import Profile
from ema_record.spread import TypeSpread, load_spread
from ema_sim.model_file import Model
from ema_sim.simulate import simulate

FLOORS = {"position_step": 0.05, "speed_step": 0.05, "bus_slope": 2e-3}
"""Least standard deviation of features that repeat exactly."""
FLOOR = 2e-4
"""Least standard deviation of any feature, of its root mean square."""


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
        healthy=np.ones((1, 3)),
        aside=(runs.conditions[sizes.ranked:], runs.features[sizes.ranked:]))


def judged_library(
    library: FleetLibrary, runs: FleetRuns, sizes: LibrarySizes, *, workers: int = 1,
    progress: Progress = silent,
) -> FleetLibrary:
    """Return the library put to scale, with what units that built nothing of it leave.

    The likelihood on runs is put to the same scale as that on the quadratic, so that one list of
    healthy scores serves both.
    """
    def units(first: int, last: int) -> list[TestedUnit]:
        return [TestedUnit(library=library, values=runs.features[k], seed=k, workers=workers,
                           conditions=conditions_of(runs.conditions[k]))
                for k in range(first, last) if np.isfinite(runs.features[k]).all()]

    some = units(sizes.units, sizes.ranked)  # not ranked: they would be closer than new ones
    costs = [unit.without_law().cost / unit.size for unit in some]
    library = replace(library, surrogate=library.surrogate.scaled(float(np.mean(costs))))
    some = units(sizes.units, sizes.ranked)
    first = [(u, u.settled(u.without_law(), None, 3, salt=3)) for u in some]
    means = [(u, fit, u.run((), fit.z, SETTLED_RUNS, salt=4)) for u, fit in first]
    library = replace(library, carried=_carried(library, means))
    healthy, ranked = [], units(sizes.ranked, sizes.total)
    for k, unit in enumerate(ranked):
        healthy.append(scores(unit, unit.without_law(), 0))
        progress("units set aside", (k + 1) / len(ranked))
    return replace(library, healthy=np.array(healthy))


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


def fleet_library(
    model: Model, profile: Profile, *, rate: float | None = None, signatures: bool = True,
    sizes: LibrarySizes = FULL, seed: int = 0, workers: int = 1, progress: Progress = silent,
    folder: Path | None = None,
) -> FleetLibrary:
    """Return the library of a model, a test and a rate, from where it is kept, else built.

    That is the present kit's `library/`, else the cache; what is not there is simulated and kept
    in `folder`, default the cache. A building that was stopped goes on where it was.
    """
    spread = load_spread()
    rate = model.actuator.acquisition.rate if rate is None else rate
    fmap = feature_map(profile, model.actuator, whole(simulate(
        profile, actuator=model.actuator, effects=model.effects, seed=seed, rate=rate),
        model.actuator))
    of_test = (json.dumps([[list(p) for p in profile.points], profile.inverter_off, rate]),
               repr(model), repr(spread), str(seed))

    def key(what: str, made_by: str, *parts: object) -> str:
        return f"{what}_{cache.key_of(*of_test, *map(repr, parts), module=made_by)}"

    def kept(name: str, make: Callable[[str], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        found = cache.load(name, kit_path(LIBRARY)) or cache.load(name)
        if found is None:
            found = make(f"part_{name}")
            cache.save(name, found, folder)
            cache.forget(f"part_{name}")
        return found

    laws: tuple[Signature, ...] = ()
    if signatures:
        laws = unpack(candidates(model), kept(
            key("laws", build_effect_library.__module__), lambda parts: {"added": pack(
                build_effect_library(model, fmap, seed=seed, workers=workers, progress=progress,
                                     keep=parts))})["added"])

    def built(_: str) -> dict[str, np.ndarray]:
        runs = FleetRuns(**kept(key("fleet", fleet_runs.__module__, tuple(sizes)),
                                lambda parts: asdict(fleet_runs(
                                    model, spread, fmap, sizes, seed=seed, workers=workers,
                                    progress=progress, keep=parts))))
        return as_arrays(judged_library(
            fitted_library(runs, model, spread, fmap, sizes, laws), runs, sizes,
            workers=workers, progress=progress))

    return from_arrays(kept(key("judged", __name__, tuple(sizes), signatures), built),
                       model, spread, fmap, laws)


def as_arrays(library: FleetLibrary) -> dict[str, np.ndarray]:
    """Return what is kept of a library; its signatures are kept by themselves."""
    found = {"weights": library.weights.astype(np.float32), "healthy": library.healthy,
             "carried": np.array(library.carried), "conditions": library.aside[0],
             "features": library.aside[1]}
    for name in ("surrogate", "repeat"):
        law = getattr(library, name)
        found |= {f"{name}_quiet": law.quiet, f"{name}_noisy": law.noisy,
                  f"{name}_correlation": law.correlation.astype(np.float32)}
    return found


def from_arrays(
    kept: Mapping[str, np.ndarray], model: Model, spread: TypeSpread, fmap: FeatureMap,
    signatures: tuple[Signature, ...],
) -> FleetLibrary:
    """Return the library of `as_arrays`."""
    surrogate, repeat = (
        NoiseLaw(quiet=kept[f"{name}_quiet"], noisy=kept[f"{name}_noisy"],
                 correlation=kept[f"{name}_correlation"].astype(float))
        for name in ("surrogate", "repeat"))
    return FleetLibrary(
        model=model, spread=spread, fmap=fmap, weights=kept["weights"].astype(float),
        signatures=signatures, surrogate=surrogate, repeat=repeat, healthy=kept["healthy"],
        carried=float(kept["carried"]), aside=(kept["conditions"], kept["features"]))
