"""What a variant of the catalogue adds to the features of a test, simulated at a few sizes.

Effects are simulated on the nominal unit at a few rotor angles, against runs without them. Their
signatures are for screening; what they propose is fitted again on the unit at hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np

from ema_identification.actuator.laws.catalogue import Signature, Variant, variants
from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.runs import Progress, UnitRun, run_cases, silent
from ema_sim.effects import EFFECTS, Effects
from ema_sim.model_file import Model


def stacked(signatures: Sequence[Signature]) -> Signature:
    """Return the signature of one variant over several tests, at the levels that all have."""
    first = signatures[0]
    levels, values = [], []
    for k in range(first.variant.size):
        common = reduce(np.intersect1d, (s.levels[k] for s in signatures))
        levels.append(common)
        values.append(np.hstack([s.values[k][np.isin(s.levels[k], common)] for s in signatures]))
    return Signature(variant=first.variant, levels=tuple(levels), values=tuple(values))


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
    seeds = _seeds(seed)
    cases = [UnitRun(angle, s) for angle, own in zip(START_ANGLES, seeds) for s in own]
    for variant in found:
        for j, levels in enumerate(variant.levels):
            for level in levels:
                effects = _alone(variant, j, level, model)
                cases += [UnitRun(angle, own[0], effects)
                          for angle, own in zip(START_ANGLES, seeds)]
    runs = run_cases(model, cases, fmap, workers=workers, progress=progress,
                     what="signatures of the catalogue", keep=keep)
    n = len(START_ANGLES)
    base = runs[:n * BASE_RUNS].reshape(n, BASE_RUNS, -1).mean(axis=1)
    added = (runs[n * BASE_RUNS:].reshape(-1, n, runs.shape[1]) - base).mean(axis=1)
    return unpack(found, added)


def _seeds(seed: int) -> list[list[int]]:
    return np.random.default_rng([seed, 2]).integers(
        2**31, size=(len(START_ANGLES), BASE_RUNS)).tolist()


def _alone(variant: Variant, j: int, level: float, model: Model) -> Effects:
    return variant.effects(level * np.eye(variant.size)[j], model.effects)


def probe_cases(model: Model, seed: int) -> list[UnitRun]:
    """Return one run of each variant: its first number at its largest."""
    own = _seeds(seed)[0][0]
    return [UnitRun(START_ANGLES[0], own, _alone(v, 0, max(v.levels[0], key=abs), model))
            for v in candidates(model)]


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
