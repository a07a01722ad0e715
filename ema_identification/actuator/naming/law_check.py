"""What the control law, measured by itself, says about what is missing (see `control_law`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.measure.controller import OFF, Gains, measured_gains
from ema_identification.actuator.measure.runs import UnitRun, simulate_case
from ema_identification.actuator.measure.tolerances import N_TOLERANCES
from ema_identification.actuator.surrogate.evidence import Evidence, RecordEvidence
from ema_record.actuator import Control
from ema_record.errors import SimulationError
from ema_sim.effects import EFFECTS, Effects

PORT = "controller"
"""Of effects that change the law. Those of the sensors do not: the controller reads them too."""


class ControlLaw(NamedTuple):
    """Whether the law of the model holds, and what may have changed it."""

    holds: bool
    excluded: tuple[str, ...] = ()
    """Effects that the law speaks against: those of the controller where it holds."""
    suspects: tuple[str, ...] = ()
    """Effects that would change it as measured."""
    text: str = ""


def check_law(
    evidence: Evidence, *, without: Sequence[str] = (), seed: int = 0
) -> ControlLaw | None:
    """Return what the law says; None if the records cannot tell it.

    Parameters
    ----------
    evidence : the records.
    without : effects that are not considered.
    seed : of the runs with which the measurement is compared.
    """
    entries = {s.variant.effect for s in evidence.blocks[0].library.signatures
               if EFFECTS[s.variant.effect].port == PORT} - set(without)
    text = ""
    for block in evidence.blocks:
        model = block.library.model
        control = model.actuator.control
        measured, own = measured_gains(block.record, model.actuator), _run(block, None, seed)
        if measured is None or own is None:
            continue
        text = measured.text(control)
        if not same_law(measured, own, control):
            return ControlLaw(holds=False, text=text, suspects=tuple(sorted(
                _suspects(block, measured, entries, seed))))
    return ControlLaw(holds=True, excluded=tuple(sorted(entries)), text=text) if text else None


def same_law(measured: Gains, other: Gains, control: Control) -> bool:
    """Whether two measurements agree.

    A delay leaves no proportional gain, and the integral one then says nothing.
    """
    if abs(measured.proportional - other.proportional) > OFF[0] * control.proportional_gain:
        return False
    delayed = abs(other.proportional / control.proportional_gain - 1.0) > OFF[0]
    return delayed or abs(measured.integral - other.integral) < OFF[1] * control.integral_gain


def _suspects(block: RecordEvidence, measured: Gains, entries: set[str], seed: int) -> set[str]:
    """Return those of `entries` that make the law as measured, at any of their sizes."""
    model, found = block.library.model, set()
    for signature in block.library.signatures:
        variant = signature.variant
        if variant.effect not in entries:
            continue
        for k, levels in enumerate(signature.levels):
            for level in levels[levels != 0.0]:
                u = np.zeros(variant.size)
                u[k] = level
                run = _run(block, variant.effects(u, model.effects), seed)
                if run is not None and same_law(measured, run, model.actuator.control):
                    found.add(variant.effect)
    return found


def _run(block: RecordEvidence, effects: Effects | None, seed: int) -> Gains | None:
    """Return the gains of a run of the nominal unit, with `effects` or as the model is."""
    library = block.library
    try:
        record = simulate_case(library.model, UnitRun(
            z=np.zeros(N_TOLERANCES), conditions=block.conditions, seed=seed, effects=effects),
            library.fmap)
    except SimulationError:
        return None
    return measured_gains(record, library.model.actuator)
