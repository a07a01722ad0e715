"""Ripple of any period: the clearest torque line that is left makes a candidate of its order."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.effect_library import Signature
from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.held_out import whitened
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.screening import Residual, Screened, best_of
from ema_identification.actuator.variants import ripple

STRONG = 8.0
"""Least residual of a line (standard deviations, re and im)."""
LOWEST = 3
"""Lower orders belong to windings and commutation."""
RIPPLES = ("cogging_torque", "gear_mesh_ripple")
RUNS = 4
SHAFT_SHARE = 1e-5
"""Transmission error (rad) that makes a ripple of some 0.01 N m."""


def largest_line(
    evidence: Evidence, residual: Sequence[np.ndarray]
) -> tuple[int, float, str] | None:
    """Return order, amplitude (N m) and segment of the clearest torque line that is left."""
    block, r = evidence.blocks[0], residual[0]
    null = block.library.null
    deviation = null.deviation(block.conditions.noise)
    texts = {s.name: s.text for s in block.library.fmap.plan.segments}
    lines: dict[tuple[str, int], list[float]] = defaultdict(list)
    clear: dict[tuple[str, int], float] = defaultdict(float)
    for feature, x, sd in zip(block.library.fmap.features, r, deviation):
        if ".torque_line_" not in feature.name:
            continue
        order = int(feature.name.split("_")[2])
        lines[feature.place, order].append(float(x * sd) * 2e-3)
        clear[feature.place, order] += float(x)**2
    if not clear:
        return None
    (place, order), power = max(clear.items(), key=lambda item: item[1])
    if power < 2.0 * STRONG**2:
        return None
    return order, float(np.linalg.norm(lines[place, order])), texts.get(place, place)


def periodic_candidates(
    evidence: Evidence, null: Recalibration, near: Residual, *, without: Sequence[str] = (),
    seed: int = 0,
) -> list[Screened]:
    """Return ripple effects with the order of the clearest line."""
    line = largest_line(evidence, whitened(evidence, null))
    if line is None or line[0] < LOWEST:
        return []
    order, torque, _ = line
    base = evidence.blocks[0].library.model
    turn = order * base.actuator.motor.pole_pairs
    found = []
    for effect in RIPPLES:
        if effect in without:
            continue
        level = torque if effect == "cogging_torque" else SHAFT_SHARE
        variant = ripple(effect, turn, level)
        values = []
        for k in range(2):
            u = np.zeros(2)
            u[k] = level
            runs = evidence.mean(null.centre, variant.effects(u, base.effects), runs=RUNS,
                                 seed=seed + 20)
            values.append(np.concatenate(runs) - np.concatenate(null.mean))
        if not np.isfinite(values).all():
            continue
        own = Signature(
            variant=variant, levels=(np.array([-level, 0.0, level]),) * 2,
            values=tuple(np.array([-v, np.zeros_like(v), v]) for v in values))
        screened = best_of(own, -1, near)
        scale = math.hypot(*screened.u)
        if scale > 0.0:
            found.append(Screened(variant=variant, index=-1, u=screened.u, cost=screened.cost,
                                  z=null.z, own=own))
    return found
