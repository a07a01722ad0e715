"""Aerodynamic torque on the surface."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class SurfaceLoad(NamedTuple):
    """Torque on the surface, constant and in proportion to its position."""

    constant: Annotated[float, Quantity("N m", -500.0, 500.0, "against positive motion")] = 0.0
    slope: Annotated[float, Quantity("N m/rad", -2000.0, 2000.0, "against deflection")] = 0.0


EFFECT = Effect(
    name="surface_load",
    parameters=SurfaceLoad,
    port="load",
    severity=("constant", "slope"),
    equation="T_load = constant + slope θ_s",
    reference=(
        "Battipede et al., section III (block TR); Etkin and Reid, Dynamics of Flight "
        "(hinge moment, linear in the deflection)"
    ),
)


@law
def torque(p: SurfaceLoad, position: float) -> float:
    """Return the torque against positive motion (N m) at surface `position` (rad)."""
    if p.constant == 0.0 and p.slope == 0.0:
        return 0.0
    return p.constant + p.slope * position
