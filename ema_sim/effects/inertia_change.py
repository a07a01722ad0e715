"""Another inertia."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class InertiaChange(NamedTuple):
    """Mass added to or lost from rotor or surface."""

    motor: Annotated[float, Quantity("1", -0.8, 5.0, "relative, of the motor")] = 0.0
    surface: Annotated[float, Quantity("1", -0.8, 20.0, "relative, of the surface")] = 0.0


EFFECT = Effect(
    name="inertia_change",
    parameters=InertiaChange,
    port="load",
    severity=("motor", "surface"),
    equation="J -> J (1 + change)",
    reference="Krause et al., Analysis of Electric Machinery and Drive Systems (T = J dω/dt)",
)


@law
def factor(change: float) -> float:
    """Return the factor on an inertia."""
    if change == 0.0:
        return 1.0
    return 1.0 + change
