"""Magnets that lost flux."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class TorqueConstantDrop(NamedTuple):
    """Demagnetisation: back-EMF and torque constant of all phases fall alike."""

    drop: Annotated[float, Quantity("1", -0.5, 0.9, "relative fall of k")] = 0.0


EFFECT = Effect(
    name="torque_constant_drop",
    parameters=TorqueConstantDrop,
    port="winding",
    severity=("drop",),
    equation="k -> k (1 - drop)",
    reference="Hendershot and Miller, Design of Brushless Permanent-Magnet Machines",
)


@law
def k_factor(p: TorqueConstantDrop) -> float:
    """Return the factor on the back-EMF constant of every phase."""
    if p.drop == 0.0:
        return 1.0
    return 1.0 - p.drop
