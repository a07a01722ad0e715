"""What acceptance records tell beside the model: the type's discrepancy, in the kit.

A kit keeps the features of the records that it was made from, not numbers that hang on a library:
the discrepancy is what the library's own fit leaves of them, and the healthy units against which
records are ranked are given its spread, one draw each, so that they stay exchangeable.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ema_identification.actuator.decision.fit import TestedUnit, units_aside
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.fleet.surrogate import Discrepancy, FleetLibrary
from ema_identification.actuator.library.form import check_array
from ema_identification.actuator.measure.features import FeatureMap, feature_map, nominal_rate
from ema_identification.actuator.measure.recorder import recorded_alike, whole
from ema_identification.actuator.measure.tolerances import CONDITIONS, align, conditions_of
from ema_record import array_cache as cache
from ema_record.errors import UsageError
from ema_record.kit import LIBRARY, kit_path
from ema_record.record import Record, unit_names
from ema_record.spread import left_over
from ema_sim.model_file import Model
from ema_sim.simulate import simulate


def _name(fmap: FeatureMap) -> str:
    """Return the name under which the records of a test are kept: of command, rate, content."""
    what = json.dumps([[list(p) for p in fmap.profile.points], fmap.profile.inverter_off,
                       fmap.rate, [f.name for f in fmap.features], CONDITIONS])
    return "acceptance_" + hashlib.sha256(what.encode()).hexdigest()[:32]


def keep_acceptance(records: Sequence[Record], model: Model, folder: Path) -> None:
    """Keep what the decision needs of acceptance records, all of one test, in a kit's library."""
    model = recorded_alike(records, model)
    first = records[0]
    rate = nominal_rate(first)
    fmap = feature_map(first.profile, model.actuator, whole(simulate(
        first.profile, actuator=model.actuator, effects=model.effects, seed=0, rate=rate),
        model.actuator))
    names, alike = unit_names(records), [
        k for k, r in enumerate(records) if r.profile.points == first.profile.points]
    rows = [whole(records[k], model.actuator) for k in alike]
    cache.save(_name(fmap), {
        "features": np.array([fmap.extract(record) for record in rows]),
        "conditions": np.array([align(record, model).row() for record in rows]),
        "unit": np.array([names.index(names[k]) for k in alike])}, folder)


def discrepancy_of(library: FleetLibrary, kept: dict[str, np.ndarray]) -> Discrepancy:
    """Return what the fits of no law leave of acceptance records.

    `kept` : features (n, d), conditions (n, 5), unit (n,), as `keep_acceptance` has them.
    """
    off, scale = [], []
    for row, values in zip(kept["conditions"], kept["features"]):
        unit = TestedUnit(library=library, values=values, conditions=conditions_of(row))
        off.append(values - unit.without_law().mean)
        scale.append(unit.whitener(0).deviation)
    return Discrepancy(*left_over(np.array(off), kept["unit"], np.mean(scale, axis=0)))


def with_acceptance(library: FleetLibrary, *, seed: int = 0) -> FleetLibrary:
    """Return the library with the discrepancy of the present kit, if it keeps one for this test.

    The units set aside are ranked anew, each with a draw of its spread.
    """
    kept = cache.load(_name(library.fmap), kit_path(LIBRARY))
    if kept is None:
        return library
    try:
        check_array("features", kept["features"], (None, len(library.fmap.features)))
        check_array("conditions", kept["conditions"], (len(kept["features"]), CONDITIONS))
        if kept["unit"].shape != kept["features"].shape[:1] or kept["unit"].dtype.kind != "i":
            raise ValueError("unit")
    except (KeyError, ValueError):
        raise UsageError(f"{kit_path(LIBRARY) / _name(library.fmap)}.npz: not of the form of "
                         "acceptance records: commission the kit again") from None
    return with_discrepancy(library, discrepancy_of(library, kept), seed=seed)


def with_discrepancy(library: FleetLibrary, left: Discrepancy, *, seed: int = 0) -> FleetLibrary:
    """Return the library with a discrepancy, its healthy units and their scores with it."""
    conditions, features = library.aside
    rng = np.random.default_rng([seed, 41])
    features = features + left.mean + left.spread * rng.standard_normal(features.shape)
    found = replace(library, left=left, aside=(conditions, features))
    name = "left_" + cache.key_of(
        hashlib.sha256(np.concatenate([library.weights.ravel(), *left]).tobytes()).hexdigest(),
        str(seed), *(s.variant.name for s in library.signatures), module=__name__)
    ranked = cache.load(name)
    if ranked is None:
        ranked = {"healthy": np.array(  # of a copy each: what a unit works out goes with it
            [scores(replace(unit)) for unit in units_aside(found) if unit])}
        cache.save(name, ranked)
    return replace(found, healthy=ranked["healthy"])
