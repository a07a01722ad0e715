"""Viscous friction: lubricant ageing or cold."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class ViscousFriction(NamedTuple):
    """Torque in proportion to speed, on the motor side, beyond the nominal one."""

    coefficient: Annotated[
        float, Quantity("N m s/rad", -1e-4, 5e-3, "added to the motor's coefficient")
    ] = 0.0


EFFECT = Effect(
    name="viscous_friction",
    parameters=ViscousFriction,
    port="friction",
    severity=("coefficient",),
    equation="T_viscous,M = (B_M + coefficient) ω",
    reference="Armstrong-Hélouvry et al. 1994, Automatica 30(7) (viscous friction)",
)


@law
def torque(p: ViscousFriction, omega: float) -> float:
    """Return the added friction torque (N m) at motor speed `omega` (rad/s)."""
    if p.coefficient == 0.0:
        return 0.0
    return p.coefficient * omega
