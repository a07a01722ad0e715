"""Rotor eccentricity: the air gap, and with it the flux linkage, varies."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from ema_sim.effects.base import Choice, Effect, Quantity
from ema_sim.effects.compile import law

PAPER, COMMON, SHIFTED, STATIC = 0, 1, 2, 3
THIRD = 2.0 * math.pi / 3.0


class RotorEccentricity(NamedTuple):
    """Rotor off centre: back-EMF constants modulated by the air gap."""

    zeta: Annotated[float, Quantity("1", -0.5, 0.5, "ζ, eccentricity a mean air gap")] = 0.0
    mode: Annotated[
        int,
        Choice(
            ("paper", "common", "shifted", "static"),
            "paper: one phase, cos θ; common: all phases, cos θ; "
            "shifted: cos(θ−φ_k); static: constant a phase",
        ),
    ] = 0
    angle: Annotated[float, Quantity("rad", -7.0, 7.0, "direction of the eccentricity")] = 0.0
    phase: Annotated[int, Choice(("a", "b", "c"), "the phase of mode paper")] = 0


EFFECT = Effect(
    name="rotor_eccentricity",
    parameters=RotorEccentricity,
    port="winding",
    severity=("zeta",),
    equation="k_k -> k_k (1 + ζ cos(θ−α)); shifted: cos(θ−α−φ_k); static: cos(α−φ_k)",
    reference=(
        "Battipede et al., section IV, eqs. 3 and 4 (paper); Ebrahimi, Faiz and Roshtkhari 2009, "
        "IEEE Trans. Ind. Electron. 56(11) (static and dynamic eccentricity)"
    ),
    fault_class="rotor_eccentricity",
)


@law
def k_factor(p: RotorEccentricity, phase: int, theta: float) -> float:
    """Return the factor on the back-EMF constant of `phase` at rotor angle `theta` (rad)."""
    if p.zeta == 0.0:
        return 1.0
    if p.mode == PAPER:
        if phase != p.phase:
            return 1.0
        return 1.0 + p.zeta * math.cos(theta - p.angle)
    if p.mode == COMMON:
        return 1.0 + p.zeta * math.cos(theta - p.angle)
    if p.mode == SHIFTED:
        return 1.0 + p.zeta * math.cos(theta - p.angle - phase * THIRD)
    return 1.0 + p.zeta * math.cos(p.angle - phase * THIRD)
