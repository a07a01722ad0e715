"""Another bus voltage."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class BusVoltageChange(NamedTuple):
    """Bus voltage that differs from the nominal one."""

    change: Annotated[float, Quantity("1", -0.5, 0.5, "relative")] = 0.0


EFFECT = Effect(
    name="bus_voltage_change",
    parameters=BusVoltageChange,
    port="supply",
    severity=("change",),
    equation="V -> V (1 + change)",
    reference="Mohan, Undeland and Robbins, Power Electronics (an inverter follows its bus)",
)


@law
def factor(p: BusVoltageChange) -> float:
    """Return the factor on the voltage of the legs."""
    if p.change == 0.0:
        return 1.0
    return 1.0 + p.change
