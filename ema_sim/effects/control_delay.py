"""Delay between controller and current loop."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class ControlDelay(NamedTuple):
    """Computation and transport delay of the reference current."""

    delay: Annotated[float, Quantity("s", 0.0, 2e-3, "of the reference current")] = 0.0


EFFECT = Effect(
    name="control_delay",
    parameters=ControlDelay,
    port="controller",
    severity=("delay",),
    equation="I_ref(t) -> I_ref(t - delay)",
    reference="Åström and Wittenmark, Computer-Controlled Systems (computational delay)",
)


@law
def periods(p: ControlDelay, control_period: float) -> float:
    """Return the delay in control periods, not rounded."""
    if p.delay == 0.0:
        return 0.0
    return p.delay / control_period
