"""Build the library of a test: fleet, repeats, laws; then judge it on units that built nothing.

The units set aside give the two things that the decision stands on: what healthy units leave, for
ranks, and how far the likelihood's scale is off, which is then put right.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
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
from ema_identification.actuator.decision.kept import (
    as_arrays,
    from_arrays,
    is_of_this_code,
    signed,
    title,
)
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.decision.surrogate import (
    SETTLED_RUNS,
    FleetLibrary,
    fitted_library,
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

SHARES = {True: (0.0, 0.3, 0.8, 1.0), False: (0.0, 0.0, 0.7, 1.0)}
"""Of the time: until the catalogue, the healthy runs and the units set aside are done; with and
without a catalogue."""
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
    healthy, ranked = [], [
        TestedUnit(library=library, values=values, conditions=conditions_of(row))
        for row, values in zip(*library.aside) if np.isfinite(values).all()]
    for k, unit in enumerate(ranked):
        healthy.append(scores(unit, unit.without_law(), 0))
        said(SCALED_SHARE + (1.0 - SCALED_SHARE) * (k + 1) / len(ranked))
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

    That is the present kit's `library/`, else the cache; what is not there, or not of this code,
    is simulated and kept in `folder`, default the cache. A building that was stopped goes on
    where it was.
    """
    spread = load_spread()
    rate = model.actuator.acquisition.rate if rate is None else rate
    fmap = feature_map(profile, model.actuator, whole(simulate(
        profile, actuator=model.actuator, effects=model.effects, seed=seed, rate=rate),
        model.actuator))
    what = title(model, spread, fmap, sizes, seed)
    names = [f"library_{what}", *([] if signatures else [f"plain_{what}"])]
    for name in names:
        for place in (kit_path(LIBRARY), None):
            kept = cache.load(name, place)
            if kept is not None:
                progress("checking the library", 0.0)
                known = from_arrays(kept, model, spread, fmap)
                if is_of_this_code(known, kept, seed=seed, workers=workers):
                    return known if signatures else replace(known, signatures=())
    found = _built(model, spread, fmap, sizes, signatures, seed, workers, progress)
    cache.save(names[-1], signed(found, seed=seed, workers=workers), folder, compressed=True)
    return found


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
