"""Wear of hinges and screw: more dry friction on the surface."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class SurfaceFriction(NamedTuple):
    """Dry friction of the surface, static and dynamic, raised in proportion."""

    increase: Annotated[float, Quantity("1", -0.9, 5.0, "relative increase")] = 0.0


EFFECT = Effect(
    name="surface_friction",
    parameters=SurfaceFriction,
    port="friction",
    severity=("increase",),
    equation="T_dry,S -> T_dry,S (1 + increase)",
    reference="Battipede et al., section IV; Borello and Dalla Vedova (dry friction)",
    fault_class="friction",
)


@law
def budget(p: SurfaceFriction, torque: float) -> float:
    """Return what the effect adds to a dry friction torque of the surface (N m)."""
    if p.increase == 0.0:
        return 0.0
    return p.increase * torque
