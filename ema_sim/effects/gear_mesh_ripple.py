"""Transmission error of the gear mesh."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class GearMeshRipple(NamedTuple):
    """Transmission error of the mesh, periodic in the motor angle."""

    amplitude: Annotated[
        float, Quantity("rad", 0.0, 1e-3, "transmission error, at the surface")
    ] = 0.0
    periods: Annotated[float, Quantity("1", 1.0, 100.0, "periods a motor turn")] = 17.0
    phase: Annotated[float, Quantity("rad", -7.0, 7.0, "phase")] = 0.0


EFFECT = Effect(
    name="gear_mesh_ripple",
    parameters=GearMeshRipple,
    port="transmission",
    severity=("amplitude",),
    equation="θ_out = θ_m/N + A sin(n θ_m + φ); the torque transforms with dθ_out/dθ_m",
    reference="Smith, Gear Noise and Vibration (transmission error)",
)


@law
def error(p: GearMeshRipple, theta: float) -> float:
    """Return the transmission error (rad at the surface) at motor angle `theta` (rad)."""
    if p.amplitude == 0.0:
        return 0.0
    return p.amplitude * math.sin(p.periods * theta + p.phase)


@law
def error_slope(p: GearMeshRipple, theta: float) -> float:
    """Return the derivative of `error` to the motor angle."""
    if p.amplitude == 0.0:
        return 0.0
    return p.amplitude * p.periods * math.cos(p.periods * theta + p.phase)
