"""A weak supply."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class BusVoltageSag(NamedTuple):
    """Source resistance: the bus falls with the current that the inverter draws on average.

    What a leg switches the capacitor of the DC link gives; through the source goes the mean.
    """

    resistance: Annotated[float, Quantity("Ω", 0.0, 2.0, "of the source, both rails")] = 0.0
    capacitance: Annotated[float, Quantity("F", 1e-5, 0.1, "of the DC link, rail to rail")] = 1e-3


EFFECT = Effect(
    name="bus_voltage_sag",
    parameters=BusVoltageSag,
    port="supply",
    severity=("resistance",),
    equation="V -> V - R_s i_s / 2 a rail, R_s C di_s/dt = Σ s_k i_k / 2 - i_s",
    reference="Mohan, Undeland and Robbins, Power Electronics (bus current of an inverter)",
)


@law
def rail_drop(p: BusVoltageSag, current: float) -> float:
    """Return the drop of each rail (V) at the current of the source (A)."""
    if p.resistance == 0.0:
        return 0.0
    return 0.5 * p.resistance * current


@law
def supply(p: BusVoltageSag, current: float, charge: float, h: float) -> tuple[float, float]:
    """Return the current of the source (A) and its charge (A s) after a step.

    Parameters
    ----------
    p : parameters.
    current : of the source before (A).
    charge : that the inverter draws in the step, evenly (A s). h : its length (s).
    """
    if p.resistance == 0.0:
        return charge / h, charge
    time = p.resistance * p.capacitance
    after = current - math.expm1(-h / time) * (charge / h - current)
    return after, charge - time * (after - current)
