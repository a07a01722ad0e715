"""Libraries, built once a model and profile, calibrated on fresh units, and kept.

The null library knows how a run repeats. What recalibration adds, such as limit cycles that no
slope describes, is measured here: units that built no library are recalibrated. Their residuals
give each feature its scale, and the cost of a complete model and the best gain of a useless
effect their distributions.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ema_identification.actuator.measure.features import feature_map
from ema_identification.actuator.measure.recorder import whole
from ema_identification.actuator.measure.runs import (
    Progress,
    UnitRun,
    silent,
    simulate_case,
    spread_out,
)
from ema_identification.actuator.measure.tolerances import (
    RecordConditions,
    align,
    draw_conditions,
    draw_tolerances,
)
from ema_identification.actuator.surrogate.evidence import (
    RecordEvidence,
    evidence,
    noise_covariance,
)
from ema_identification.actuator.surrogate.library import Library, NullLibrary, Scale
from ema_identification.actuator.surrogate.library_runs import (
    build_effect_library,
    build_null_library,
    candidates,
    pack,
    unpack,
)
from ema_identification.actuator.surrogate.likelihood import (
    LAST_RUNS,
    recalibrate,
    recalibrated_at,
)
from ema_identification.actuator.surrogate.screening import (
    bounded_gains,
    residual,
    screen_catalogue,
)
from ema_record import array_cache as cache
from ema_record.kit import LIBRARY, kit_path
from ema_record.profile import Profile
from ema_record.spread import load_spread
from ema_sim.model_file import Model
from ema_sim.simulate import simulate

FRESH_UNITS = 48
CHUNK = 2
MEMORY = 10.0
"""Units that the prior scale of a feature counts for."""
PRIOR_SCALE = 1.1
HIGHEST = 20.0
"""Largest scale of the variance of a feature."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Unit:
    block: RecordEvidence
    centre: np.ndarray
    mean: np.ndarray


def _case(seed: int, index: int) -> UnitRun:
    rng = np.random.default_rng([seed, 4, index])
    return UnitRun(z=draw_tolerances(rng), conditions=draw_conditions(rng),
                   seed=int(rng.integers(2**31)))


def _block(library: Library, case: UnitRun) -> RecordEvidence:
    record = simulate_case(library.model, case, library.fmap)
    return RecordEvidence(record=record, library=library, conditions=align(record, library.model),
                          values=library.fmap.extract(record))


def _chunk(library: Library, seed: int, indices: Sequence[int]) -> np.ndarray:
    """Return rows of features, tolerances and simulated features of recalibrated units."""
    from threadpoolctl import threadpool_limits

    rows = []
    with threadpool_limits(limits=1):
        for index in indices:
            block = _block(library, _case(seed, index))
            found = recalibrate(evidence([block]), seed=seed + index)
            rows.append(np.concatenate([
                block.values, found.mean[0], found.centre,
                [block.conditions.temperature, block.conditions.bus, block.conditions.noise,
                 block.conditions.start_angle]]))
    return np.array(rows)


def calibration_runs(
    library: Library, *, seed: int, workers: int = 1, progress: Progress = silent,
    units: int | None = None,
) -> np.ndarray:
    """Return the rows from which `scale_of` takes its numbers, one a unit."""
    n = FRESH_UNITS if units is None else units
    chunks = [list(range(i, min(i + CHUNK, n))) for i in range(0, n, CHUNK)]
    plain = replace(library, signatures=())
    return np.concatenate(spread_out(
        _chunk, [(plain, seed, c) for c in chunks], workers=workers, progress=progress,
        what="fresh effect-free units"))


def scale_of(library: Library, rows: np.ndarray) -> Scale:
    """Return the scales from the rows of `calibration_runs`."""
    units = [_unit(library, row) for row in rows]
    squares = np.zeros(len(library.fmap.features))
    for unit in units:
        found = recalibrated_at(evidence([unit.block]), unit.centre, [unit.mean], LAST_RUNS)
        slope = evidence([unit.block]).slopes(unit.centre)[0]
        rest = unit.block.values - unit.mean - slope @ (found.z - unit.centre)
        squares += rest**2 / np.diag(noise_covariance(unit.block, runs=LAST_RUNS))
    factor = (squares + MEMORY * PRIOR_SCALE) / (len(units) + MEMORY)
    factor = np.clip(factor, 1.0, HIGHEST)
    library = replace(library, scale=replace(library.scale, factor=factor))
    costs, gains = [], []
    for unit in units:
        ev = evidence([replace(unit.block, library=library)])
        costs.append(recalibrated_at(ev, unit.centre, [unit.mean], LAST_RUNS).cost / ev.size)
        if library.signatures:
            rest = residual(ev, unit.centre, [unit.mean], runs=LAST_RUNS)
            gains.append(max(bounded_gains(
                ev, unit.centre, [unit.mean], LAST_RUNS, screen_catalogue(ev, rest))))
    logs = np.log(costs)
    middle = float(np.median(gains)) if gains else 10.0
    tail = 5.0
    if gains:
        tail = max((float(np.quantile(gains, 0.9)) - middle) / math.log(5.0),
                   (float(np.max(gains)) - middle) / math.log(len(gains)), 2.0)
    return Scale(factor=factor, fit=(float(logs.mean()), max(float(logs.std(ddof=1)), 0.05)),
                 gain=(middle, tail))


def _unit(library: Library, row: np.ndarray) -> _Unit:
    d = len(library.fmap.features)
    temperature, bus, noise, angle = row[-4:]
    conditions = RecordConditions(
        temperature=float(temperature), bus=float(bus), noise=float(noise),
        start_angle=float(angle), measured=frozenset({"temperature", "bus"}))
    block = RecordEvidence(record=library.example, library=library, conditions=conditions,
                           values=row[:d])
    return _Unit(block=block, centre=row[2 * d:-4], mean=row[d:2 * d])


def _key(model: Model, profile: Profile, rate: float, made_by: Callable[..., object], seed: int
         ) -> str:
    command = [list(p) for p in profile.points]
    return cache.key_of(
        json.dumps([command, profile.inverter_off, rate]), repr(model), repr(load_spread()),
        str(seed), module=made_by.__module__)


def _kept(key: str) -> dict[str, np.ndarray] | None:
    """Return arrays from the kit's library, else from the cache."""
    found = cache.load(key, kit_path(LIBRARY))
    return cache.load(key) if found is None else found


def library(
    model: Model, profile: Profile, *, rate: float | None = None, signatures: bool = True,
    seed: int = 0, workers: int = 1, progress: Progress = silent, folder: Path | None = None,
) -> Library:
    """Return the library of a model, a profile and a rate, from where it is kept.

    That is the present kit's `library/`, else the cache; what is not there is simulated and kept
    in `folder`, default the cache.
    """
    rate = model.actuator.acquisition.rate if rate is None else rate
    example = whole(simulate(profile, actuator=model.actuator, effects=model.effects, seed=seed,
                             rate=rate), model.actuator)
    fmap = feature_map(profile, model.actuator, example)
    key = "null_" + _key(model, profile, rate, build_null_library, seed)
    stored = _kept(key)
    names = ("weights", "quiet", "noisy", "correlation", "misfit")
    if stored is None or set(stored) != set(names):
        null = build_null_library(model, fmap, seed=seed, workers=workers, progress=progress)
        cache.save(key, {name: getattr(null, name) for name in names}, folder)
    else:
        null = NullLibrary(**{name: stored[name] for name in names})
    plain = Library(model=model, fmap=fmap, null=null, signatures=(), example=example,
                    scale=Scale(factor=np.ones(len(fmap.features))))
    if not signatures:
        return plain
    key = "effects_" + _key(model, profile, rate, build_effect_library, seed)
    stored = _kept(key)
    if stored is None or "added" not in stored:
        found = build_effect_library(model, fmap, seed=seed, workers=workers, progress=progress)
        cache.save(key, {"added": pack(found)}, folder)
    else:
        found = unpack(candidates(model), np.asarray(stored["added"]))
    full = replace(plain, signatures=found)
    key = "scale_" + _key(model, profile, rate, scale_of, seed)
    stored = _kept(key)
    if stored is None or set(stored) != {"factor", "fit", "gain"}:
        scale = scale_of(full, calibration_runs(
            full, seed=seed, workers=workers, progress=progress))
        cache.save(key, {"factor": scale.factor, "fit": np.array(scale.fit),
                         "gain": np.array(scale.gain)}, folder)
    else:
        fit, gain = stored["fit"], stored["gain"]
        scale = Scale(factor=stored["factor"], fit=(float(fit[0]), float(fit[1])),
                      gain=(float(gain[0]), float(gain[1])))
    return replace(full, scale=scale)
