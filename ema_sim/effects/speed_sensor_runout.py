"""Run-out of the speed sensor."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class SpeedSensorRunout(NamedTuple):
    """Speed sensor mounted off centre: once a turn the reading swings."""

    amplitude: Annotated[float, Quantity("1", 0.0, 0.2, "of the speed")] = 0.0
    angle: Annotated[float, Quantity("rad", -7.0, 7.0, "rotor angle of the maximum")] = 0.0


EFFECT = Effect(
    name="speed_sensor_runout",
    parameters=SpeedSensorRunout,
    port="sensor",
    severity=("amplitude",),
    equation="ω_measured = ω (1 + a cos(θ_r - α)), inside the loop",
    reference="geometry: a disc of radius r, off centre by e, reads with a = e / r to first order",
)


@law
def factor(p: SpeedSensorRunout, theta: float) -> float:
    """Return the factor on the measured speed at mechanical angle `theta` (rad)."""
    if p.amplitude == 0.0:
        return 1.0
    return 1.0 + p.amplitude * math.cos(theta - p.angle)
