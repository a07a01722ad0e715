"""Cogging: magnets against teeth."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class CoggingTorque(NamedTuple):
    """Reluctance torque between magnets and teeth, periodic in the rotor angle."""

    amplitude: Annotated[float, Quantity("N m", 0.0, 2.0, "of the torque")] = 0.0
    periods: Annotated[float, Quantity("1", 1.0, 400.0, "periods a mechanical turn")] = 12.0
    phase: Annotated[float, Quantity("rad", -7.0, 7.0, "phase")] = 0.0


EFFECT = Effect(
    name="cogging_torque",
    parameters=CoggingTorque,
    port="motor torque",
    severity=("amplitude",),
    equation="T = A sin(n θ_r + φ)",
    reference="Hanselman, Brushless Permanent Magnet Motor Design (cogging torque)",
)


@law
def torque(p: CoggingTorque, theta: float) -> float:
    """Return the torque on the rotor (N m) at mechanical angle `theta` (rad)."""
    if p.amplitude == 0.0:
        return 0.0
    return p.amplitude * math.sin(p.periods * theta + p.phase)
