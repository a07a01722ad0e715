"""Ripple of any period: the clearest torque line that is left makes a candidate of its order."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.effect_library import Signature
from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.fit import Fit
from ema_identification.actuator.held_out import whitened
from ema_identification.actuator.largest_line import largest_line
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.screening import Screened, best_of, residual
from ema_identification.actuator.variants import ripple

LOWEST = 3
"""Lower orders belong to windings and commutation."""
RIPPLES = ("cogging_torque", "gear_mesh_ripple")
RUNS = 4
SHARE = 0.05
"""Of the size of an effect found before, by which it may give way (times 100, `residual`)."""
SHAFT_SHARE = 1e-5
"""Transmission error (rad) that makes a ripple of some 0.01 N m."""


def free_columns(fit: Fit) -> list[np.ndarray]:
    """Return what a share of each fitted coordinate adds, shape (d,) each.

    In units of the features, not of the coordinate: a transmission error of 1 rad would move them
    by so much that nothing else counted.
    """
    sizes = np.repeat([float(np.linalg.norm(t.u)) for t in fit.terms],
                      [t.variant.size for t in fit.terms])
    return list((SHARE * fit.slopes[:, :fit.free] * sizes).T)


def periodic_candidates(
    evidence: Evidence, about: Recalibration | Fit, *, without: Sequence[str] = (), seed: int = 0,
) -> list[Screened]:
    """Return ripple effects with the order of the clearest line that `about` leaves."""
    line = largest_line(evidence, whitened(evidence, about))
    if line is None or line[0] < LOWEST:
        return []
    order, torque, _ = line
    base = evidence.blocks[0].library.model
    turn = order * base.actuator.motor.pole_pairs
    if isinstance(about, Fit):
        effects, centre = about.effects(base.effects), about.z
        free = free_columns(about)
    else:
        effects, centre, free = base.effects, about.centre, []
    rest = residual(evidence, centre, about.mean, runs=about.runs, free=free)
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
            runs = evidence.mean(centre, variant.effects(u, effects), runs=RUNS, seed=seed + 20)
            values.append(np.concatenate(runs) - np.concatenate(about.mean))
        if not np.isfinite(values).all():
            continue
        own = Signature(
            variant=variant, levels=(np.array([-level, 0.0, level]),) * 2,
            values=tuple(np.array([-v, np.zeros_like(v), v]) for v in values))
        screened = best_of(own, -1, rest)
        if math.hypot(*screened.u) > 0.0:
            found.append(Screened(variant=variant, index=-1, u=screened.u, cost=screened.cost,
                                  z=about.z, own=own))
    return found
