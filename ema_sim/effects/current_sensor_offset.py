"""Offset of the current sensors."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class CurrentSensorOffset(NamedTuple):
    """Offsets of the current sensors; the current loop acts on what they read."""

    phase_a: Annotated[float, Quantity("A", -5.0, 5.0, "offset of sensor a")] = 0.0
    phase_b: Annotated[float, Quantity("A", -5.0, 5.0, "offset of sensor b")] = 0.0
    phase_c: Annotated[float, Quantity("A", -5.0, 5.0, "offset of sensor c")] = 0.0


EFFECT = Effect(
    name="current_sensor_offset",
    parameters=CurrentSensorOffset,
    port="sensor",
    severity=("phase_a", "phase_b", "phase_c"),
    equation="i_k,measured = i_k + offset_k",
    reference="Chung and Sul 1998, IEEE Trans. Ind. Appl. (current measurement errors)",
)


@law
def offset(p: CurrentSensorOffset, phase: int) -> float:
    """Return the offset of the sensor of `phase` (A)."""
    return p.phase_a if phase == 0 else (p.phase_b if phase == 1 else p.phase_c)
