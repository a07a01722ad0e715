"""All that depends only on model and profile, built once and kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from ema_identification import cache
from ema_identification.actuator.calibration import calibration_runs, scale_of
from ema_identification.actuator.effect_library import (
    build_effect_library,
    candidates,
    pack,
    unpack,
)
from ema_identification.actuator.features import feature_map
from ema_identification.actuator.library_type import Library, Scale
from ema_identification.actuator.null_library import NullLibrary, build_null_library
from ema_identification.actuator.runs import Progress, silent
from ema_record.profile import Profile
from ema_sim.actuator import Model
from ema_sim.simulate import simulate

FEATURE_CODE = ("segments", "signals", "lines", "consistency", "transitions", "features", "spread",
                "runs")
SOURCES = {"null": (*FEATURE_CODE, "null_library"),
           "effects": (*FEATURE_CODE, "variants", "effect_library"),
           "scale": (*FEATURE_CODE, "null_library", "alignment", "evidence", "tolerances",
                     "bounded", "recalibration", "screening", "calibration")}
"""Files of this package that decide what is kept."""


def _key(model: Model, profile: Profile, part: str, seed: int) -> str:
    command = [list(p) for p in profile.points]
    here = Path(__file__).parent
    return cache.key_of(
        json.dumps([command, profile.inverter_off]), repr(model), part, str(seed),
        sources=[here / f"{name}.py" for name in SOURCES[part]],
    )


def library(
    model: Model, profile: Profile, *, signatures: bool = True, seed: int = 0, workers: int = 1,
    progress: Progress = silent,
) -> Library:
    """Return the library of a model and a profile, from the cache where it is kept."""
    example = simulate(profile, actuator=model.actuator, effects=model.effects, seed=seed)
    fmap = feature_map(profile, model.actuator, example)
    key = "null_" + _key(model, profile, "null", seed)
    stored = cache.load(key)
    names = ("weights", "quiet", "noisy", "correlation", "misfit")
    if stored is None or set(stored) != set(names):
        null = build_null_library(model, fmap, seed=seed, workers=workers, progress=progress)
        cache.save(key, {name: getattr(null, name) for name in names})
    else:
        null = NullLibrary(**{name: stored[name] for name in names})
    plain = Library(model=model, fmap=fmap, null=null, signatures=(), example=example,
                    scale=Scale(factor=np.ones(len(fmap.features))))
    if not signatures:
        return plain
    key = "effects_" + _key(model, profile, "effects", seed)
    stored = cache.load(key)
    if stored is None or "added" not in stored:
        found = build_effect_library(model, fmap, seed=seed, workers=workers, progress=progress)
        cache.save(key, {"added": pack(found)})
    else:
        found = unpack(candidates(model), np.asarray(stored["added"]))
    full = replace(plain, signatures=found)
    key = "scale_" + _key(model, profile, "scale", seed)
    stored = cache.load(key)
    if stored is None or set(stored) != {"factor", "fit", "gain"}:
        scale = scale_of(full, calibration_runs(
            full, seed=seed, workers=workers, progress=progress))
        cache.save(key, {"factor": scale.factor, "fit": np.array(scale.fit),
                         "gain": np.array(scale.gain)})
    else:
        fit, gain = stored["fit"], stored["gain"]
        scale = Scale(factor=stored["factor"], fit=(float(fit[0]), float(fit[1])),
                      gain=(float(gain[0]), float(gain[1])))
    return replace(full, scale=scale)
