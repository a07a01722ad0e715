"""Backlash: wear of gear, screw and hinges."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class Backlash(NamedTuple):
    """Lost motion added to that of a healthy transmission."""

    increase: Annotated[
        float, Quantity("rad", -1e-4, 0.05, "total lost motion added, at the surface")
    ] = 0.0


EFFECT = Effect(
    name="backlash",
    parameters=Backlash,
    port="transmission",
    severity=("increase",),
    equation="b -> b + increase; T = K sign(δ) max(|δ| − b/2, 0)",
    reference="Battipede et al., section IV; Nordin and Gutman 2002, Automatica 38(10)",
    fault_class="backlash",
)


@law
def lost_motion(p: Backlash, nominal: float) -> float:
    """Return the total lost motion (rad at the surface)."""
    if p.increase == 0.0:
        return nominal
    return max(0.0, nominal + p.increase)
