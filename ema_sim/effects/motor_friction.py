"""Wear of motor bearings and gear: more dry friction on the motor side."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class MotorFriction(NamedTuple):
    """Dry friction of the motor side, static and dynamic, raised in proportion."""

    increase: Annotated[float, Quantity("1", -0.9, 5.0, "relative increase")] = 0.0


EFFECT = Effect(
    name="motor_friction",
    parameters=MotorFriction,
    port="friction",
    severity=("increase",),
    equation="T_dry,M -> T_dry,M (1 + increase)",
    reference="Battipede et al., section IV; Borello and Dalla Vedova (dry friction)",
    fault_class="friction",
)


@law
def budget(p: MotorFriction, torque: float) -> float:
    """Return what the effect adds to a dry friction torque of the motor (N m)."""
    if p.increase == 0.0:
        return 0.0
    return p.increase * torque
