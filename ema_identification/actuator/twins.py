"""Starts for the other of two effects that are nearly one machine (`inseparable`).

A short changes the constants of the phases as a static eccentricity along its phase does, with
another common factor. Where a fit of one is complete the other one is tried at just that place:
the screening, which keeps the tolerances small, may never lead there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.contest import Start
from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.fit import Fit, Term
from ema_identification.actuator.inseparable import PHASES, phase_constants
from ema_identification.actuator.recalibration import BAND
from ema_identification.actuator.screening import selectable, stacked
from ema_identification.actuator.spread import TOLERANCES
from ema_sim.effects.rotor_eccentricity import THIRD

ECCENTRIC = "rotor_eccentricity static"


def twins(evidence: Evidence, fit: Fit, *, without: Sequence[str] = ()) -> list[Start]:
    """Return starts of the effect that makes nearly the same machine as a fit; [] if none does.

    Parameters
    ----------
    evidence : the records.
    fit : of one effect.
    without : effects that are not to be considered.
    """
    (term,) = fit.terms
    base = evidence.blocks[0].library.model.effects
    made = phase_constants(fit.effects(base)) / phase_constants(base)
    phase = int(np.argmin(made))
    fraction = 1.0 - made[phase] / np.delete(made, phase).mean()
    if term.variant.effect == "turn_short":
        zeta, axis = fraction / (1.5 - 0.5 * fraction), phase * THIRD
        wanted = {ECCENTRIC: -zeta * np.array([np.cos(axis), np.sin(axis)])}
    elif term.variant.name == ECCENTRIC:
        wanted = {f"turn_short {PHASES[phase]} {mode}": np.array([fraction])
                  for mode in ("paper", "physical")}
    else:
        return []
    starts = []
    for index in selectable(evidence, without):
        variant = evidence.blocks[0].library.signatures[index].variant
        if variant.name in wanted:
            there = Term(variant=variant, signature=stacked(evidence, index),
                         u=wanted[variant.name])
            ratio = made * phase_constants(base) / phase_constants(
                variant.effects(there.u, base))
            starts.append(Start((there,), _with_constants(fit.z, ratio)))
    return starts


def _with_constants(z: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Return tolerances with the constants of the phases changed by `ratio`, in their bands."""
    changes = {"motor.back_emf_constant": ratio.mean() - 1.0} | {
        f"motor.back_emf_deviation_{p}": r / ratio.mean() - 1.0 for p, r in zip(PHASES, ratio)}
    moved = z.copy()
    for k, tolerance in enumerate(TOLERANCES):
        moved[k] += changes.get(tolerance.name, 0.0) / tolerance.half_width
    return np.asarray(np.clip(moved, -BAND, BAND))
