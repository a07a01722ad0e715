"""Add: the model with recalibrated parameters and the effects found, as its YAML file."""

from __future__ import annotations

from typing import Any

import numpy as np
import yaml

from ema_identification.actuator.spread import N_TOLERANCES, Conditions, realise
from ema_sim.actuator import Model
from ema_sim.effects import EFFECTS, Effects
from ema_sim.effects.base import Choice
from ema_sim.parameters import Actuator

HEADER = "# Written by ema identify: recalibrated parameters, and the effects that were found.\n"


def updated_actuator(model: Model, z: np.ndarray) -> Actuator:
    """Return the actuator of a unit: tolerances of its hardware, shape (18,) or longer."""
    actuator, _ = realise(model, z[:N_TOLERANCES], Conditions())
    return actuator


def model_text(model: Model, z: np.ndarray, effects: Effects) -> str:
    """Return the model file: every parameter that differs from nominal, and the effects."""
    nominal = Actuator()
    data: dict[str, Any] = {}
    for section, part in updated_actuator(model, z)._asdict().items():
        base = getattr(nominal, section)
        changed = {name: _number(value) for name, value in part._asdict().items()
                   if value != getattr(base, name)}
        if changed:
            data[section] = changed
    added: dict[str, Any] = {}
    for name, effect in EFFECTS.items():
        values = getattr(effects, name)
        if effect.is_neutral(values):
            continue
        added[name] = {
            f.name: f.kind.options[int(getattr(values, f.name))] if isinstance(f.kind, Choice)
            else _number(getattr(values, f.name))
            for f in effect.fields
            if getattr(values, f.name) != f.default or f.name in effect.severity
        }
    if added:
        data["effects"] = added
    return HEADER + yaml.safe_dump(data, sort_keys=False, allow_unicode=True)


def _number(value: float) -> float | int:
    return int(value) if isinstance(value, int) else float(f"{value:.8g}")
