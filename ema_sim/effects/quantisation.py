"""Coarser converters."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class Quantisation(NamedTuple):
    """Converters of position and speed that lost their lowest bits."""

    position_bits_lost: Annotated[
        float, Quantity("1", 0.0, 10.0, "bits, of the position converter")
    ] = 0.0
    speed_bits_lost: Annotated[
        float, Quantity("1", 0.0, 10.0, "bits, of the speed converter")
    ] = 0.0


EFFECT = Effect(
    name="quantisation",
    parameters=Quantisation,
    port="sensor",
    severity=("position_bits_lost", "speed_bits_lost"),
    equation="step -> step 2^lost, inside the loop",
    reference="Battipede et al., section III (analogue to digital conversion)",
)


@law
def coarser(lost: float) -> float:
    """Return the factor on a converter's step."""
    if lost == 0.0:
        return 1.0
    return 2.0**lost
