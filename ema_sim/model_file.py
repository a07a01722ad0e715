"""Model files: parameters of the actuator and effects that belong to it, in YAML."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from pydantic import TypeAdapter, ValidationError

from ema_record.actuator import Actuator
from ema_record.errors import UsageError, first_problem, unknown_name
from ema_record.resources import share_path
from ema_record.yaml_file import load_yaml
from ema_sim.effects.registry import Effects
from ema_sim.effects.settings import effects_from_mapping

NOMINAL = "config/actuator.yaml"
_PARTS = {name: TypeAdapter(type(part)) for name, part in Actuator()._asdict().items()}


class Model(NamedTuple):
    """An actuator with the effects that its model file adds."""

    actuator: Actuator
    effects: Effects


def load_actuator(path: str | Path | None = None) -> Actuator:
    """Return the parameters of a model file, default the nominal ones."""
    return load_model_file(path).actuator


def load_model_file(path: str | Path | None = None) -> Model:
    """Return what a model file describes.

    Sections are those of `parameters.Actuator`, and `effects` with the catalogue's dotted
    or nested names. What is left out keeps the nominal value.
    """
    nominal = _actuator_from(load_yaml(share_path(NOMINAL)), NOMINAL, Actuator())
    if path is None:
        return Model(nominal.actuator, nominal.effects)
    return _actuator_from(load_yaml(Path(path)), str(path), nominal.actuator)


def _actuator_from(data: object, where: str, base: Actuator) -> Model:
    if not isinstance(data, Mapping):
        raise UsageError(f"{where}: expected sections such as 'motor:', see {NOMINAL}")
    actuator, effects = base, Effects()
    for section, values in data.items():
        if section == "effects":
            if not isinstance(values, Mapping):
                raise UsageError(f"{where}: effects: expected names and values")
            effects = effects_from_mapping(values)
            continue
        if section not in _PARTS:
            raise unknown_name(f"section of {where}", str(section), [*_PARTS, "effects"],
                               f"see {NOMINAL}")
        if not isinstance(values, Mapping):
            raise UsageError(f"{where}: {section}: expected parameters and values")
        part = getattr(actuator, section)
        for name in values:
            if name not in part._fields:
                raise unknown_name(f"parameter of {section} in {where}", str(name), part._fields,
                                   f"see {NOMINAL}")
        try:
            checked = _PARTS[section].validate_python({**part._asdict(), **values})
        except ValidationError as error:
            text = first_problem(error, f"{where}: {section}", section, f"see {NOMINAL}")
            raise UsageError(text) from None
        actuator = actuator._replace(**{section: checked})
    return Model(actuator, effects)
