"""Model files: parameters of the actuator and effects that belong to it, in YAML."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from ema_record.actuator import Actuator, actuator_from, load_actuator, sections_of
from ema_record.errors import UsageError
from ema_sim.effects.registry import Effects
from ema_sim.effects.settings import effects_from_mapping


class Model(NamedTuple):
    """An actuator with the effects that its model file adds."""

    actuator: Actuator
    effects: Effects


def load_model_file(path: str | Path | None = None) -> Model:
    """Return what a model file describes, default the nominal actuator without effects.

    Sections are those of `Actuator`, and `effects` with the catalogue's dotted or nested
    names. What is left out keeps the nominal value.
    """
    if path is None:
        return Model(load_actuator(), Effects())
    data = sections_of(path)
    effects = data.get("effects", {})
    if not isinstance(effects, Mapping):
        raise UsageError(f"{path}: effects: expected names and values")
    return Model(actuator_from(data, str(path)), effects_from_mapping(effects))
