"""A softer shaft."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class ShaftCompliance(NamedTuple):
    """Crack, loose joint or wear that softens the shaft."""

    increase: Annotated[
        float, Quantity("1", -0.8, 20.0, "relative increase of the compliance")
    ] = 0.0


EFFECT = Effect(
    name="shaft_compliance",
    parameters=ShaftCompliance,
    port="transmission",
    severity=("increase",),
    equation="K -> K / (1 + increase)",
    reference="Ellis and Lorenz 2000, IEEE IAS Annual Meeting (two inertias, compliant shaft)",
)


@law
def stiffness(p: ShaftCompliance, nominal: float) -> float:
    """Return the stiffness of the shaft (N m/rad)."""
    if p.increase == 0.0:
        return nominal
    return nominal / (1.0 + p.increase)
