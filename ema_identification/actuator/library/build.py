"""Build the library of a test: fleet, repeats, laws; then judge it on units that built nothing.

The units set aside give the two things that the decision stands on: what healthy units leave, for
ranks, and how far the likelihood's scale is off, which is then put right. A library is kept under
a name of what it is of; the code is not in it, since every comment would make it another. Where
other code made a file, some of what it holds is made again: what differs by more than another
realisation of the noise, as another processor gives it, is of another model, and built anew.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from ema_identification.actuator.decision.fit import TestedUnit, units_aside
from ema_identification.actuator.decision.proposals import Scores, scores
from ema_identification.actuator.fleet.surrogate import (
    SETTLED_RUNS,
    FleetLibrary,
    NoiseLaw,
    bent,
    fitted_library,
)
from ema_identification.actuator.fleet.units import (
    CHUNK,
    FULL,
    FleetRuns,
    LibrarySizes,
    fleet_runs,
)
from ema_identification.actuator.laws.catalogue import Signature
from ema_identification.actuator.laws.signatures import (
    build_effect_library,
    candidates,
    pack,
    probe_cases,
    unpack,
)
from ema_identification.actuator.laws.terms import LawFit
from ema_identification.actuator.library.form import check_form
from ema_identification.actuator.measure.features import FeatureMap, feature_map
from ema_identification.actuator.measure.recorder import whole
from ema_identification.actuator.measure.runs import Progress, run_cases, silent, spread_out
from ema_identification.actuator.measure.tolerances import (
    CONDITIONS,
    NOISES,
    NOMINAL,
    conditions_of,
)
from ema_record import array_cache as cache
from ema_record.kit import LIBRARY, kit_path
from ema_record.profile import Profile
from ema_record.spread import TypeSpread, load_spread
from ema_sim.model_file import Model
from ema_sim.simulate import simulate

VERSION = 4
"""To be raised where `judged_library` makes something else of the same runs."""
MADE_BY = "ema_identification.actuator.library.build"
"""What a library depends on is what this module imports."""
PROBED = LibrarySizes(units=8, repeated=0, scaled=0, set_aside=0)
RANKED = 3
"""Units set aside that are ranked again."""
OTHER_NOISE = 2.0
"""Largest mean square of differences; of runs that share nothing but the physics it is 1."""
SAME = 1e-6, 0.01
"""Relative error of the same statistics; of the same ranks."""
ROUND = 64.0
"""Parts of a deviation to which features are kept."""
FINER = 4.0
"""Times finer are the weights kept, of which many add up."""
CORRELATION = 2.0**-14
"""Step of correlations."""
SHARES = {True: (0.0, 0.3, 0.8, 1.0), False: (0.0, 0.0, 0.7, 1.0)}
"""Of the time until laws, healthy runs and units set aside are done; with and without laws."""
SCALED_SHARE = 0.4
"""Of the time of the units set aside, that of those that set the scale."""


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
    said = partial(progress, "units set aside")
    library = replace(library, surrogate=library.surrogate.scaled(float(np.mean(costs))))
    some = units(sizes.units, sizes.ranked)
    first = [(u, u.settled(u.without_law(), None, 3, salt=3)) for u in some]
    means = []
    for k, (u, fit) in enumerate(first):
        means.append((u, fit, u.run((), fit.z, SETTLED_RUNS, salt=4)))
        said(SCALED_SHARE * (k + 1) / len(first))
    library = replace(library, carried=_carried(library, means))
    n = len(library.aside[0])
    healthy = spread_out(
        partial(_ranked, library), [(k, k + CHUNK) for k in range(0, n, CHUNK)], workers=workers,
        progress=lambda _, share: said(SCALED_SHARE + (1.0 - SCALED_SHARE) * share))
    return replace(library, healthy=np.concatenate(healthy))


def _ranked(library: FleetLibrary, first: int, last: int) -> np.ndarray:
    """Return the scores of some of the units set aside, shape (n, 4); of failed runs none."""
    return np.array([scores(unit) for unit in units_aside(library)[first:last] if unit]).reshape(
        -1, len(Scores._fields))


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

    That is the present kit's `library/`, else the cache; what is not there, or not of this code,
    is simulated and kept in `folder`, default the cache. A building that was stopped goes on
    where it was.
    """
    spread = load_spread()
    fmap = feature_map(profile, model.actuator, whole(simulate(
        profile, actuator=model.actuator, effects=model.effects, seed=seed, rate=rate),
        model.actuator))
    what = title(model, spread, fmap, sizes, seed)
    names = [f"library_{what}", *([] if signatures else [f"plain_{what}"])]
    for name in names:
        for place in (kit_path(LIBRARY), None):
            kept = cache.load(name, place)
            if kept is None:
                continue
            progress("checking the library", 0.0)
            with contextlib.suppress(KeyError, ValueError, IndexError):  # damaged: made anew
                check_form(kept, len(fmap.features))
                known = from_arrays(kept, model, spread, fmap)
                if is_of_this_code(known, kept, seed=seed, workers=workers):
                    return known if signatures else replace(known, signatures=())
    found = _built(model, spread, fmap, sizes, signatures, seed, workers, progress)
    cache.save(names[-1], signed(found, seed=seed, workers=workers), folder, compressed=True)
    kept = cache.load(names[-1], folder)  # as a later use has it, in the order of its elements too
    return found if kept is None else from_arrays(kept, model, spread, fmap)


def _built(
    model: Model, spread: TypeSpread, fmap: FeatureMap, sizes: LibrarySizes, signatures: bool,
    seed: int, workers: int, progress: Progress,
) -> FleetLibrary:
    """Return a library from runs, which are kept in the cache."""
    of_test = (repr(fmap.profile.points), repr(fmap.profile.inverter_off), repr(fmap.rate),
               repr(model), repr(spread), str(seed))

    def kept(what: str, made_by: str, make: Callable[[str], dict[str, np.ndarray]], *parts: object
             ) -> dict[str, np.ndarray]:
        name = f"{what}_{cache.key_of(*of_test, *map(repr, parts), module=made_by)}"
        found = cache.load(name)
        if found is None:
            found = make(f"part_{name}")
            cache.save(name, found)
            cache.forget(f"part_{name}")
        return found

    def said(part: int) -> Progress:
        begin, end = SHARES[signatures][part:part + 2]
        return lambda _, share: progress(
            f"library of {fmap.profile.name}", begin + (end - begin) * share)

    laws: tuple[Signature, ...] = ()
    if signatures:
        laws = unpack(candidates(model), kept(
            "laws", build_effect_library.__module__, lambda parts: {"added": pack(
                build_effect_library(model, fmap, seed=seed, workers=workers, progress=said(0),
                                     keep=parts))})["added"])
    runs = FleetRuns(**kept(
        "fleet", fleet_runs.__module__, lambda parts: asdict(fleet_runs(
            model, spread, fmap, sizes, seed=seed, workers=workers, progress=said(1),
            keep=parts)), tuple(sizes)))
    fitted = fitted_library(runs, model, spread, fmap, sizes, laws)
    return judged_library(from_arrays(as_arrays(fitted), model, spread, fmap), runs, sizes,
                          workers=workers, progress=said(2))


def title(model: Model, spread: TypeSpread, fmap: FeatureMap, sizes: LibrarySizes, seed: int
          ) -> str:
    """Return a hash of what a library is of."""
    profile: Profile = fmap.profile
    parts = (VERSION, profile.points, profile.inverter_off, fmap.rate, model, spread, seed,
             tuple(sizes), fmap.features, [(v.name, v.levels) for v in candidates(model)])
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32]


def as_arrays(library: FleetLibrary) -> dict[str, np.ndarray]:
    """Return what is kept of a library."""
    step = library.repeat.deviation((0.5, 0.5)) / ROUND
    found = {"weights": cache.rounded(library.weights, step / FINER), "healthy": library.healthy,
             "carried": np.array(library.carried), "conditions": library.aside[0],
             "features": cache.rounded(library.aside[1], step)}
    for name in ("surrogate", "repeat"):
        law = getattr(library, name)
        found |= {f"{name}_quiet": law.quiet, f"{name}_noisy": law.noisy, f"{name}_correlation":
                  cache.rounded(law.correlation[np.tril_indices(len(law.quiet), -1)], CORRELATION)}
    if library.signatures:
        found["added"] = cache.rounded(pack(library.signatures), step)
    return found


def from_arrays(
    kept: Mapping[str, np.ndarray], model: Model, spread: TypeSpread, fmap: FeatureMap,
) -> FleetLibrary:
    """Return the library of `as_arrays`."""
    surrogate, repeat = (
        NoiseLaw(quiet=kept[f"{name}_quiet"], noisy=kept[f"{name}_noisy"],
                 correlation=_whole(kept[f"{name}_correlation"], len(kept[f"{name}_quiet"])))
        for name in ("surrogate", "repeat"))
    signatures: tuple[Signature, ...] = ()
    if "added" in kept:
        signatures = unpack(candidates(model), kept["added"].astype(float))
    return FleetLibrary(
        model=model, spread=spread, fmap=fmap, weights=kept["weights"].astype(float),
        signatures=signatures, surrogate=surrogate, repeat=repeat, healthy=kept["healthy"],
        carried=float(kept["carried"]),
        aside=(kept["conditions"], kept["features"].astype(float)))


def _whole(below: np.ndarray, size: int) -> np.ndarray:
    """Return the correlation of what stands below its diagonal."""
    found = np.zeros((size, size))
    found[np.tril_indices(size, -1)] = below
    return np.asarray(found + found.T + np.eye(size))


def probed(library: FleetLibrary, *, seed: int, workers: int = 1) -> dict[str, np.ndarray]:
    """Return what is compared of a library, made by the present code."""
    runs = fleet_runs(library.model, library.spread, library.fmap, PROBED, seed=seed)
    deviation = library.repeat.deviation(NOMINAL) / ROUND
    found = {"probed_units": cache.rounded(runs.features, deviation),
             "probed_days": runs.conditions, "probed_fit": _statistics(library)}
    if library.signatures:
        found["probed_laws"] = cache.rounded(run_cases(
            library.model, probe_cases(library.model, seed), library.fmap, workers=workers),
            deviation)
    return found


def _statistics(library: FleetLibrary) -> np.ndarray:
    """Return what is fitted to numbers that are always the same."""
    rng = np.random.default_rng(5)
    sizes = LibrarySizes(units=400, repeated=100, scaled=0, set_aside=0)
    n, d, width = sizes.units, 3, library.width
    runs = FleetRuns(z=rng.uniform(-1.0, 1.0, (n, width)), features=rng.normal(size=(n, d)),
                     conditions=np.column_stack([rng.uniform(-1.0, 1.0, (n, 2)),
                                                 rng.uniform(0.3, 2.0, (n, CONDITIONS - 2))]),
                     again=rng.normal(size=(sizes.repeated, d)))
    found = fitted_library(runs, library.model, library.spread,
                           replace(library.fmap, features=library.fmap.features[:d]), sizes)
    return np.concatenate([found.weights.ravel(), *(part.ravel() for law in (
        found.surrogate, found.repeat) for part in (law.quiet, law.noisy, law.correlation))])


def signed(library: FleetLibrary, *, seed: int, workers: int = 1) -> dict[str, np.ndarray]:
    """Return what is kept of a library with what made it, and probes of that."""
    return as_arrays(library) | probed(library, seed=seed, workers=workers) | {
        "made_by": np.array(cache.key_of(module=MADE_BY)),
        "test": np.array(library.fmap.profile.name)}


def is_of_this_code(
    library: FleetLibrary, kept: Mapping[str, np.ndarray], *, seed: int, workers: int = 1
) -> bool:
    """Return whether the present code would make this library; what was found is kept."""
    if str(kept["made_by"]) == cache.key_of(module=MADE_BY):
        return True
    content = hashlib.sha256(b"".join(kept[k].tobytes() for k in sorted(kept))).hexdigest()
    marker = f"agreed_{cache.key_of(content, module=MADE_BY)}"
    if cache.load(marker) is None:
        if not agrees(library, kept, probed(library, seed=seed, workers=workers)):
            return False
        cache.save(marker, {"agreed": np.array(True)})
    return True


def agrees(
    library: FleetLibrary, kept: Mapping[str, np.ndarray], found: Mapping[str, np.ndarray]
) -> bool:
    """Return whether the probes that are kept and those `found` are of one code."""
    if any(k not in kept or kept[k].shape != x.shape for k, x in found.items()):
        return False
    fit, ranks = SAME
    power = np.sqrt((kept["probed_fit"] ** 2).mean())
    ranked = [scores(unit) for unit in [u for u in units_aside(library) if u][:RANKED]]
    return (np.abs(found["probed_fit"] - kept["probed_fit"]).max() <= fit * power
            and np.allclose(ranked, library.healthy[:RANKED], rtol=ranks)
            and max(differences(library, kept, found)) <= OTHER_NOISE)


def differences(
    library: FleetLibrary, kept: Mapping[str, np.ndarray], found: Mapping[str, np.ndarray]
) -> Sequence[float]:
    """Return mean squares of the differences of probes: 0 the same, 1 other noise.

    Of the healthy units; of what is common to them; of what is common to the runs of laws.
    """
    scales = {"probed_units": library.repeat.deviation(kept["probed_days"][:, NOISES]),
              "probed_laws": library.repeat.deviation(NOMINAL)}
    result = []
    for name, scale in scales.items():
        if name in kept:
            good = np.isfinite(kept[name]).all(axis=1)
            if (np.isfinite(found[name]).all(axis=1) != good).any():
                return [np.inf]
            off = bent(((found[name] - kept[name]) / scale)[good])
            result.append(float(0.5 * len(off) * (off.mean(axis=0) ** 2).mean()))
            if name == "probed_units":
                result.append(float(0.5 * (off**2).mean()))
    return result
