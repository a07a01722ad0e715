"""Commutation sensor turned against the rotor."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class HallMisalignment(NamedTuple):
    """Commutation sensor that is not aligned with the back-EMF."""

    angle: Annotated[
        float, Quantity("rad", -0.5, 0.5, "electrical; positive: the sensor reads ahead")
    ] = 0.0


EFFECT = Effect(
    name="hall_misalignment",
    parameters=HallMisalignment,
    port="commutation",
    severity=("angle",),
    equation="commutation uses θ + angle; the recorded rotor angle has it too",
    reference="Samoylenko et al. 2008, IEEE Trans. Energy Convers. (misaligned Hall sensors)",
)


@law
def sensor_angle(p: HallMisalignment) -> float:
    """Return what the commutation sensor adds to the electrical angle (rad)."""
    return p.angle
