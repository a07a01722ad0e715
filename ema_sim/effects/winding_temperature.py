"""Temperature of winding and magnets."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law
from ema_sim.machine import COPPER, MAGNET, REFERENCE


class WindingTemperature(NamedTuple):
    """Winding and magnets warmer or colder than at nominal: R rises, k falls."""

    temperature: Annotated[
        float, Quantity("degC", -60.0, 200.0, "of winding and magnets; nominal at 20")
    ] = REFERENCE
    magnet_coefficient: Annotated[
        float, Quantity("1/K", -5e-3, 0.0, "relative change of k")
    ] = MAGNET


EFFECT = Effect(
    name="winding_temperature",
    parameters=WindingTemperature,
    port="winding",
    severity=("temperature",),
    equation="R -> R (1 + 0.00393 ΔT), k -> k (1 + α ΔT), ΔT = T - 20 degC",
    reference="IEC 60028 (copper, 0.00393/K at 20 degC); NdFeB remanence -0.11 %/K",
)


@law
def resistance_factor(p: WindingTemperature) -> float:
    """Return the factor on the resistance of every phase."""
    if p.temperature == REFERENCE:
        return 1.0
    return 1.0 + COPPER * (p.temperature - REFERENCE)


@law
def k_factor(p: WindingTemperature) -> float:
    """Return the factor on the back-EMF constant of every phase."""
    if p.temperature == REFERENCE:
        return 1.0
    return 1.0 + p.magnet_coefficient * (p.temperature - REFERENCE)
