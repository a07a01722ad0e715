"""Friction of loaded teeth and bearings."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class LoadDependentFriction(NamedTuple):
    """Dry friction of the motor side in proportion to the torque that the gear carries."""

    coefficient: Annotated[
        float, Quantity("1", 0.0, 1.0, "friction a transmitted torque, at the motor")
    ] = 0.0


EFFECT = Effect(
    name="load_dependent_friction",
    parameters=LoadDependentFriction,
    port="friction",
    severity=("coefficient",),
    equation="T_dry,M -> T_dry,M + μ |T_shaft| / N",
    reference="Pelchen, Schweiger and Otter 2002, Modelica Conference (lossy gear)",
)


@law
def budget(p: LoadDependentFriction, transmitted: float) -> float:
    """Return what the effect adds to the dry friction (N m), from the torque carried (N m)."""
    if p.coefficient == 0.0:
        return 0.0
    return p.coefficient * abs(transmitted)
