"""Friction that falls with speed."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class StribeckFriction(NamedTuple):
    """Mixed lubrication at low speed: dry friction of the motor side rises towards standstill."""

    increase: Annotated[
        float, Quantity("1", -0.5, 3.0, "relative increase of the dynamic friction at speed 0")
    ] = 0.0
    speed: Annotated[float, Quantity("rad/s", 0.5, 500.0, "Stribeck speed of the motor")] = 20.0


EFFECT = Effect(
    name="stribeck_friction",
    parameters=StribeckFriction,
    port="friction",
    severity=("increase",),
    equation="T_dry,M -> T_dry,M (1 + increase exp(-(ω/ω_s)²)); at standstill at least as large",
    reference="Armstrong-Hélouvry et al. 1994, Automatica 30(7) (Stribeck curve)",
)
NOTHING = 746.0
"""exp(-746) is 0; the function says so ten times as slowly, and healthy units ask it each step."""


@law
def budget(p: StribeckFriction, torque: float, omega: float) -> float:
    """Return what the effect adds to the dynamic friction `torque` (N m) at speed `omega`."""
    if p.increase == 0.0:
        return 0.0
    ratio = omega / p.speed
    square = ratio * ratio
    return p.increase * torque * (0.0 if square > NOTHING else math.exp(-square))
