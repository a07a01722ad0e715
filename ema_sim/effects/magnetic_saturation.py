"""Iron that saturates with the phase current."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class MagneticSaturation(NamedTuple):
    """Inductance and flux linkage of a phase fall with its current."""

    inverse_current: Annotated[
        float, Quantity("1/A", 0.0, 0.2, "1/I_s; at I_s the factors are one half")
    ] = 0.0


EFFECT = Effect(
    name="magnetic_saturation",
    parameters=MagneticSaturation,
    port="winding",
    severity=("inverse_current",),
    equation="k, L -> k, L / (1 + (i/I_s)²)",
    reference="form after Vas, Electrical Machines and Drives",
)


@law
def factor(p: MagneticSaturation, current: float) -> float:
    """Return the factor on k and L of a phase at its `current` (A)."""
    if p.inverse_current == 0.0:
        return 1.0
    return 1.0 / (1.0 + (p.inverse_current * current) ** 2)
