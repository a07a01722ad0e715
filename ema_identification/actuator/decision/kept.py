"""Libraries in files: small, and used only where the present code makes the same.

A file is named by what it is of: model, spread, test, rate, seed, sizes, features, catalogue. The
code is not in its name, since every comment would make it another. A file says which code made
it; where that is not the present one, some of what it holds is made again: the first healthy
units, one run of each variant of the catalogue, the statistics of numbers that are always the
same, the ranks of the first units set aside. What differs by more than another realisation of the
noise, as another processor gives it, is of other code, and the library is built anew.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.fleet import (
    SIZE,
    FleetRuns,
    LibrarySizes,
    conditions_of,
    fleet_runs,
)
from ema_identification.actuator.decision.proposals import healthy_scores
from ema_identification.actuator.decision.surrogate import (
    FleetLibrary,
    NoiseLaw,
    bent,
    fitted_library,
)
from ema_identification.actuator.laws.catalogue import Signature
from ema_identification.actuator.laws.signatures import candidates, pack, probe_cases, unpack
from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.runs import run_cases
from ema_record import array_cache as cache
from ema_record.profile import Profile
from ema_record.spread import TypeSpread
from ema_sim.model_file import Model

VERSION = 1
"""To be raised where `library.judged_library` makes something else of the same runs."""
MADE_BY = "ema_identification.actuator.decision.library"
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


def title(model: Model, spread: TypeSpread, fmap: FeatureMap, sizes: LibrarySizes, seed: int
          ) -> str:
    """Return a hash of what a library is of."""
    profile: Profile = fmap.profile
    parts = (VERSION, profile.points, profile.inverter_off, fmap.rate, model, spread, seed,
             tuple(sizes), fmap.features, [(v.name, v.levels) for v in candidates(model)])
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32]


def rounded(values: np.ndarray, step: np.ndarray | float) -> np.ndarray:
    """Return values in float32, on multiples of the next lower power of two of `step`.

    Their last bits are zero, so that they are kept in few bytes.
    """
    grid = 2.0 ** np.floor(np.log2(step))
    return np.asarray(np.round(values / grid) * grid, dtype=np.float32)


def as_arrays(library: FleetLibrary) -> dict[str, np.ndarray]:
    """Return what is kept of a library."""
    step = library.repeat.deviation(0.5) / ROUND
    found = {"weights": rounded(library.weights, step / FINER), "healthy": library.healthy,
             "carried": np.array(library.carried), "conditions": library.aside[0],
             "features": rounded(library.aside[1], step)}
    for name in ("surrogate", "repeat"):
        law = getattr(library, name)
        found |= {f"{name}_quiet": law.quiet, f"{name}_noisy": law.noisy, f"{name}_correlation":
                  rounded(law.correlation[np.tril_indices(len(law.quiet), -1)], CORRELATION)}
    if library.signatures:
        found["added"] = rounded(pack(library.signatures), step)
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
    deviation = library.repeat.deviation(1.0) / ROUND
    found = {"probed_units": rounded(runs.features, deviation), "probed_days": runs.conditions,
             "probed_fit": _statistics(library)}
    if library.signatures:
        found["probed_laws"] = rounded(run_cases(
            library.model, probe_cases(library.model, seed), library.fmap, workers=workers),
            deviation)
    return found


def _statistics(library: FleetLibrary) -> np.ndarray:
    """Return what is fitted to numbers that are always the same."""
    rng = np.random.default_rng(5)
    sizes = LibrarySizes(units=400, repeated=100, scaled=0, set_aside=0)
    n, d = sizes.units, 3
    runs = FleetRuns(z=rng.uniform(-1.0, 1.0, (n, SIZE)), features=rng.normal(size=(n, d)),
                     conditions=np.column_stack([rng.uniform(-1.0, 1.0, (n, 2)),
                                                 rng.uniform(0.3, 2.0, (n, 2))]),
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
    units = [(c, y) for c, y in zip(*library.aside) if np.isfinite(y).all()][:RANKED]
    ranked = [healthy_scores(TestedUnit(library=library, values=y, conditions=conditions_of(c)))
              for c, y in units]
    return (np.abs(found["probed_fit"] - kept["probed_fit"]).max() <= fit * power
            and np.allclose(ranked, library.healthy[:RANKED], rtol=ranks)
            and max(differences(library, kept, found)) <= OTHER_NOISE)


def differences(
    library: FleetLibrary, kept: Mapping[str, np.ndarray], found: Mapping[str, np.ndarray]
) -> Sequence[float]:
    """Return mean squares of the differences of probes: 0 the same, 1 other noise.

    Of the healthy units; of what is common to them; of what is common to the runs of laws.
    """
    noise = kept["probed_days"][:, 2]
    scales = {"probed_units": np.array([library.repeat.deviation(x) for x in noise]),
              "probed_laws": library.repeat.deviation(1.0)}
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
