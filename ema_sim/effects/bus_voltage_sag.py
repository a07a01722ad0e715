"""A weak supply."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class BusVoltageSag(NamedTuple):
    """Source resistance: the bus falls with the current that the inverter draws."""

    resistance: Annotated[float, Quantity("Ω", 0.0, 2.0, "of the source, both rails")] = 0.0


EFFECT = Effect(
    name="bus_voltage_sag",
    parameters=BusVoltageSag,
    port="supply",
    severity=("resistance",),
    equation="V -> V - R_s i_bus / 2 a rail, i_bus = Σ s_k i_k / 2",
    reference="Mohan, Undeland and Robbins, Power Electronics (bus current of an inverter)",
)


@law
def rail_drop(p: BusVoltageSag, bus_current: float) -> float:
    """Return the drop of each rail (V) at the bus current (A)."""
    if p.resistance == 0.0:
        return 0.0
    return 0.5 * p.resistance * bus_current
