"""The model file that an identification writes."""

from __future__ import annotations

from typing import Any

import yaml

from ema_record.actuator import Actuator, load_actuator
from ema_sim.effects import EFFECTS, Effects
from ema_sim.effects.base import Choice

HEADER = "# Written by ema identify: recalibrated parameters, and the effects that were found.\n"


def model_file_text(actuator: Actuator, effects: Effects) -> str:
    """Return the model file: every parameter that differs from nominal, and the effects."""
    nominal = load_actuator()
    data: dict[str, Any] = {}
    for section, part in actuator._asdict().items():
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
