"""A bad joint in one phase."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Choice, Effect, Quantity
from ema_sim.effects.compile import law


class PhaseResistanceImbalance(NamedTuple):
    """Contact or joint resistance in one phase."""

    increase: Annotated[float, Quantity("1", -0.5, 5.0, "relative increase of R")] = 0.0
    phase: Annotated[int, Choice(("a", "b", "c"), "the phase")] = 0


EFFECT = Effect(
    name="phase_resistance_imbalance",
    parameters=PhaseResistanceImbalance,
    port="winding",
    severity=("increase",),
    equation="R_k -> R_k (1 + increase) in one phase",
    reference="Hang et al. 2016, IEEE Trans. Power Electron. (high-resistance connection)",
)


@law
def resistance_factor(p: PhaseResistanceImbalance, phase: int) -> float:
    """Return the factor on the resistance of `phase`."""
    if p.increase == 0.0 or phase != p.phase:
        return 1.0
    return 1.0 + p.increase
