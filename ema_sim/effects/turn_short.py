"""Coil short circuit between turns of one phase."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ema_sim.effects.base import Choice, Effect, Quantity
from ema_sim.effects.compile import law

PAPER = 0


class TurnShort(NamedTuple):
    """Shorted turns in one phase: fewer active turns make less flux linkage."""

    fraction: Annotated[float, Quantity("1", 0.0, 0.9, "x, shorted turns of all turns")] = 0.0
    phase: Annotated[int, Choice(("a", "b", "c"), "the phase")] = 0
    mode: Annotated[
        int, Choice(("paper", "physical"), "paper: k only; physical: k, R and L")
    ] = 1
    fault_conductance: Annotated[
        float, Quantity("S", 0.0, 1e3, "of the short; 0: no circulating current")
    ] = 0.0


EFFECT = Effect(
    name="turn_short",
    parameters=TurnShort,
    port="winding",
    severity=("fraction",),
    equation=(
        "k -> k (1-x); physical also R -> R (1-x), L -> L (1-x)²; "
        "drag T = (x k(θ))² ω / (x R + 1/G) with fault conductance G"
    ),
    reference=(
        "Battipede et al., section IV, eq. 4 (factor Ce of one phase); physical: k and R in "
        "proportion to the turns, L to their square (Hanselman, Brushless Permanent Magnet "
        "Motor Design)"
    ),
    fault_class="turn_short",
)


@law
def k_factor(p: TurnShort, phase: int) -> float:
    """Return the factor on the back-EMF constant of `phase`."""
    if p.fraction == 0.0 or phase != p.phase:
        return 1.0
    return 1.0 - p.fraction


@law
def resistance_factor(p: TurnShort, phase: int) -> float:
    """Return the factor on the resistance of `phase`."""
    if p.fraction == 0.0 or phase != p.phase or p.mode == PAPER:
        return 1.0
    return 1.0 - p.fraction


@law
def inductance_factor(p: TurnShort, phase: int) -> float:
    """Return the factor on the inductance of `phase`."""
    if p.fraction == 0.0 or phase != p.phase or p.mode == PAPER:
        return 1.0
    return (1.0 - p.fraction) ** 2


@law
def drag_torque(
    p: TurnShort, k_a: float, k_b: float, k_c: float, resistance: float, omega: float
) -> float:
    """Return the drag of the circulating current (N m), from k(θ) of the healthy turns left."""
    if p.fraction == 0.0 or p.fault_conductance == 0.0 or p.mode == PAPER:
        return 0.0
    k = k_a if p.phase == 0 else (k_b if p.phase == 1 else k_c)
    shorted = k * p.fraction / (1.0 - p.fraction)
    return shorted**2 * omega / (p.fraction * resistance + 1.0 / p.fault_conductance)
