"""Back-EMF that is not the nominal trapezoid."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Effect, Quantity
from ema_sim.effects.compile import law


class BackEmfShape(NamedTuple):
    """Shape of the back-EMF: narrower or wider flat top, harmonics, sinusoidal winding."""

    flat_top_change: Annotated[
        float, Quantity("rad", -2.0, 0.9, "added to the width of the flat top")
    ] = 0.0
    fifth_harmonic: Annotated[
        float, Quantity("1", -0.3, 0.3, "5th harmonic, of the amplitude")
    ] = 0.0
    sine_share: Annotated[
        float, Quantity("1", 0.0, 1.0, "share of a pure sine in place of the trapezoid")
    ] = 0.0


EFFECT = Effect(
    name="back_emf_shape",
    parameters=BackEmfShape,
    port="winding",
    severity=("flat_top_change", "fifth_harmonic", "sine_share"),
    equation=(
        "shape = (1-s) trapezoid(θ, top + change) + s sin θ + c5 sin 5θ; harmonics in place of "
        "the trapezoid: plus what the change does to one"
    ),
    reference="Pillay and Krishnan 1989, IEEE Trans. Ind. Appl. 25(2) (back-EMF of BLDC drives)",
)


@law
def width(p: BackEmfShape, nominal: float) -> float:
    """Return the width of the flat top (rad)."""
    if p.flat_top_change == 0.0:
        return nominal
    return min(3.0, max(0.0, nominal + p.flat_top_change))


@law
def shape(p: BackEmfShape, value: float, sine: float) -> float:
    """Return the unit shape where it is `value` without this effect and `sine` is sin θ."""
    if p.sine_share != 0.0:
        value += p.sine_share * (sine - value)
    if p.fifth_harmonic != 0.0:
        square = sine * sine
        value += p.fifth_harmonic * sine * (5.0 + square * (16.0 * square - 20.0))  # sin 5θ
    return value


@law
def needs_sine(p: BackEmfShape) -> bool:
    """Whether `shape` looks at the sine."""
    return p.sine_share != 0.0 or p.fifth_harmonic != 0.0
