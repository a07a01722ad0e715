"""Effects that make one and the same machine: no command tells them apart.

A static eccentricity along the axis of a phase makes the constants of the three phases k (1 - ζ),
k (1 + ζ/2), k (1 + ζ/2): those of a machine whose k is 1 + ζ/2 times as large, with a short of
1.5 ζ / (1 + ζ/2) in that phase. The common factor lies within the tolerance of k, and what lies
across the axis within that of each phase. Only resistance and inductance tell a real short.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.fit import Fit
from ema_identification.actuator.spread import TOLERANCES
from ema_sim.effects import Effects, rotor_eccentricity, turn_short
from ema_sim.effects.rotor_eccentricity import STATIC

PHASES = "abc"
PAIR = {"turn_short", "rotor_eccentricity"}
WITHIN = next(t.half_width for t in TOLERANCES if t.name == "motor.back_emf_deviation_a")
"""Range of the ratio of two machines' constants, over the phases, that a unit may have anyway."""


def phase_constants(effects: Effects) -> np.ndarray:
    """Return the factors on the back-EMF constants of the phases, shape (3,)."""
    return np.array([
        turn_short.k_factor(effects.turn_short, k)
        * rotor_eccentricity.k_factor(effects.rotor_eccentricity, k, 0.0) for k in range(3)])


def inseparable(fits: Sequence[Fit], base: Effects) -> str:
    """Return why no command tells two fits apart, and what would; empty if one may.

    Parameters
    ----------
    fits : candidates that the data cannot tell apart.
    base : effects that the model has.
    """
    if len(fits) != 2 or {f.terms[-1].variant.effect for f in fits} != PAIR:
        return ""
    by_name = {f.terms[-1].variant.effect: f.effects(base) for f in fits}
    short, eccentric = by_name["turn_short"], by_name["rotor_eccentricity"]
    if eccentric.rotor_eccentricity.mode != STATIC:
        return ""
    ratio = phase_constants(eccentric) / phase_constants(short)
    if np.ptp(ratio) / ratio.mean() > WITHIN:
        return ""
    phase, part = PHASES[short.turn_short.phase], 100.0 * short.turn_short.fraction
    return (
        "measure the resistance of the three phases at standstill (a short makes that of phase "
        f"{phase} {part:.1f} % lower than the others'); no test tells turn_short of phase {phase} "
        "and rotor_eccentricity along its axis apart, both change the same constants"
    )
