"""Offset of the position transducer."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class PositionSensorOffset(NamedTuple):
    """Electrical offset of the position transducer."""

    offset: Annotated[float, Quantity("rad", -0.1, 0.1, "at the surface")] = 0.0


EFFECT = Effect(
    name="position_sensor_offset",
    parameters=PositionSensorOffset,
    port="sensor",
    severity=("offset",),
    equation="θ_s,measured = θ_s + offset, inside the loop",
    reference="Battipede et al., section III (electrical offset of the position transducers)",
)


@law
def offset(p: PositionSensorOffset) -> float:
    """Return what the transducer adds (rad)."""
    return p.offset
