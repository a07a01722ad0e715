"""Voltage drop of the switches."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law

KNEE = 0.1
"""Current at which the drop is fully there (A)."""


class InverterVoltageDrop(NamedTuple):
    """Forward drop of transistors and diodes, against the current."""

    drop: Annotated[float, Quantity("V", 0.0, 10.0, "of a leg")] = 0.0


EFFECT = Effect(
    name="inverter_voltage_drop",
    parameters=InverterVoltageDrop,
    port="supply",
    severity=("drop",),
    equation="v_k -> v_k - U sat(i_k / 0.1 A)",
    reference="Choi and Sul 1996, IEEE Trans. Ind. Electron. (inverter output voltage error)",
)


@law
def voltage(p: InverterVoltageDrop, current: float) -> float:
    """Return the drop of a leg (V) at its `current` (A)."""
    if p.drop == 0.0:
        return 0.0
    return p.drop * min(1.0, max(-1.0, current / KNEE))
