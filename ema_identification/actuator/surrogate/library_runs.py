"""The runs from which a library is built: of effect-free units, and of the catalogue.

Units are drawn from the fleet, each is run twice with other noise. The mean of the pairs gives
the dependence of the features on tolerances and conditions (quadratic, ridge); the differences
give the covariance of a repeat, which grows with the noise of the sensors.

Effects are simulated on the nominal unit at a few rotor angles, against runs without them. Their
signatures are for screening; what they propose is fitted again on the unit at hand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.runs import Progress, UnitRun, run_cases, silent
from ema_identification.actuator.measure.tolerances import (
    N_TOLERANCES,
    RecordConditions,
    draw_conditions,
    draw_tolerances,
)
from ema_identification.actuator.surrogate.catalogue import Variant, variants
from ema_identification.actuator.surrogate.library import NullLibrary, Signature, design
from ema_sim.effects import EFFECTS
from ema_sim.model_file import Model

NULL_UNITS = 450
"""Units of a library; each is run twice."""
RIDGE = 1.0
SHRINK = 0.3
"""Share of the identity in the correlation of a repeat."""
FLOORS = {"position_step": 0.05, "speed_step": 0.05, "bus_slope": 2e-3}
"""Least standard deviation of features that repeat exactly."""
FLOOR = 2e-4
"""Least standard deviation of any feature, of its root mean square."""


def build_null_library(
    model: Model, fmap: FeatureMap, *, seed: int = 0, workers: int = 1,
    progress: Progress = silent, units: int | None = None,
) -> NullLibrary:
    """Simulate the units and return their statistics."""
    cases: list[UnitRun] = []
    for k in range(NULL_UNITS if units is None else units):
        rng = np.random.default_rng([seed, 1, k])
        case = UnitRun(z=draw_tolerances(rng), conditions=draw_conditions(rng),
                       seed=int(rng.integers(2**31)))
        cases += [case, replace(case, seed=int(rng.integers(2**31)))]
    found = run_cases(model, cases, fmap, workers=workers, progress=progress,
                      what="effect-free runs")
    first, second = found[0::2], found[1::2]
    good = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    pairs = [c for c, g in zip(cases[0::2], good) if g]
    v = np.array([np.concatenate([c.z, c.conditions.regressors()]) for c in pairs])
    noise = np.array([c.conditions.noise for c in pairs])
    mean, difference = 0.5 * (first + second)[good], ((first - second) / np.sqrt(2.0))[good]
    columns = design(v)
    penalty = RIDGE * np.eye(columns.shape[1])
    penalty[0, 0] = 0.0
    weights = np.linalg.solve(columns.T @ columns + penalty, columns.T @ mean)
    floor = (FLOOR * np.sqrt((mean**2).mean(axis=0)) + 1e-6)**2
    for k, feature in enumerate(fmap.features):
        floor[k] = max(floor[k], FLOORS.get(feature.name, 0.0)**2)
    quiet, noisy = _noise_law(difference, noise)
    quiet = np.maximum(quiet, floor)
    scaled = difference / np.sqrt(quiet + noisy * noise[:, None]**2)
    correlation = np.clip(scaled, -6.0, 6.0).T @ np.clip(scaled, -6.0, 6.0) / len(scaled)
    root = np.sqrt(np.maximum(np.diag(correlation), 1e-3))
    correlation = (1.0 - SHRINK) * correlation / np.outer(root, root)
    np.fill_diagonal(correlation, 1.0)
    rest = mean - columns @ weights
    freedom = max(1, len(mean) - columns.shape[1])
    misfit = (rest**2).sum(axis=0) / freedom - 0.5 * (difference**2).mean(axis=0)
    return NullLibrary(weights=weights, quiet=quiet, noisy=noisy, correlation=correlation,
                       misfit=np.maximum(misfit, 0.0))


def _noise_law(difference: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a, b >= 0 of variance = a + b noise², from a quiet and a noisy half."""
    half = noise < np.median(noise)
    low, high = (difference[half]**2).mean(axis=0), (difference[~half]**2).mean(axis=0)
    n_low, n_high = float((noise[half]**2).mean()), float((noise[~half]**2).mean())
    slope = np.clip((high - low) / (n_high - n_low), 0.0, high / n_high)
    return np.maximum(high - slope * n_high, 0.0), slope


START_ANGLES = (0.4, 2.0, 3.5, 5.1)
BASE_RUNS = 4
"""Runs without an effect at each start angle."""


def candidates(model: Model) -> tuple[Variant, ...]:
    """Return the variants of effects that the model does not have yet."""
    return tuple(v for v in variants(model.actuator)
                 if EFFECTS[v.effect].is_neutral(getattr(model.effects, v.effect)))


def build_effect_library(
    model: Model, fmap: FeatureMap, *, seed: int = 0, workers: int = 1,
    progress: Progress = silent, keep: str = "",
) -> tuple[Signature, ...]:
    """Simulate the catalogue and return the signatures; `keep` as of `spread_out`."""
    found = candidates(model)
    z = np.zeros(N_TOLERANCES)
    cases: list[UnitRun] = []
    seeds = np.random.default_rng([seed, 2]).integers(2**31, size=(len(START_ANGLES), BASE_RUNS))
    for k, angle in enumerate(START_ANGLES):
        cases += [UnitRun(z=z, conditions=RecordConditions(start_angle=angle), seed=int(s))
                  for s in seeds[k]]
    for variant in found:
        for j, levels in enumerate(variant.levels):
            for level in levels:
                u = np.zeros(variant.size)
                u[j] = level
                cases += [
                    UnitRun(z=z, conditions=RecordConditions(start_angle=angle),
                            seed=int(seeds[k, 0]), effects=variant.effects(u, model.effects))
                    for k, angle in enumerate(START_ANGLES)
                ]
    runs = run_cases(model, cases, fmap, workers=workers, progress=progress,
                     what="signatures of the catalogue", keep=keep)
    n = len(START_ANGLES)
    base = runs[:n * BASE_RUNS].reshape(n, BASE_RUNS, -1).mean(axis=1)
    added = (runs[n * BASE_RUNS:].reshape(-1, n, runs.shape[1]) - base).mean(axis=1)
    return unpack(found, added)


def unpack(found: tuple[Variant, ...], added: np.ndarray) -> tuple[Signature, ...]:
    """Return signatures from the rows of all levels in order, shape (rows, d)."""
    result, row = [], 0
    for variant in found:
        all_levels, all_values = [], []
        for levels in variant.levels:
            values = added[row:row + len(levels)]
            row += len(levels)
            good = np.isfinite(values).all(axis=1)
            x = np.append(np.array(levels, dtype=float)[good], 0.0)
            y = np.vstack([values[good], np.zeros(added.shape[1])])
            order = np.argsort(x)
            all_levels.append(x[order])
            all_values.append(y[order])
        result.append(Signature(variant=variant, levels=tuple(all_levels),
                                values=tuple(all_values)))
    return tuple(result)


def pack(signatures: tuple[Signature, ...]) -> np.ndarray:
    """Return the rows that `unpack` reads; NaN for levels that could not be simulated."""
    rows = []
    for signature in signatures:
        for levels, known, values in zip(
                signature.variant.levels, signature.levels, signature.values):
            for level in levels:
                at = np.flatnonzero(known == level)
                rows.append(values[at[0]] if len(at) else np.full(values.shape[1], np.nan))
    return np.array(rows)
