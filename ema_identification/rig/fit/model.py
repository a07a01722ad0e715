"""The model file of a rig: terms with what is known of them, in YAML (docs/rigs.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, field_validator

from ema_identification.rig.laws import LAWS
from ema_record.errors import UsageError, unknown_name, validated
from ema_record.yaml_file import load_yaml
from ema_rig.map import SEE, Finite
from ema_rig.record import MAX_RIG_RATE, InputQuantity, Motion

DEFAULT_TOLERANCE = 0.1
MAX_TERMS = 60
LONGEST_NAME = 64
LARGEST = 1e12
"""Size of a parameter, at most: its square and that of its inverse are numbers."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class KnownTerm(_Part):
    """One term of the model: an effect, and the values that are known of it."""

    effect: str = Field(max_length=64)
    parameters: dict[str, Finite] = Field(default_factory=dict, max_length=10)
    """Nominal values; a linear parameter without one is free."""
    tolerance: float = Field(default=DEFAULT_TOLERANCE, ge=0.0, le=10.0)
    """How far the linear parameters may be off, relative to their size."""
    estimate: dict[str, tuple[Finite, Finite, Finite]] = Field(
        default_factory=dict, max_length=10)
    """What a record gave, value and 90 % interval; told, and exported, not used in a fit."""

    @field_validator("parameters", "estimate")
    @classmethod
    def _are_names(cls, value: dict[str, Any]) -> dict[str, Any]:
        """Refuse what is no name (it would stand in files that others run), and no number."""
        for name, numbers in value.items():
            if not (name.isascii() and name.isidentifier() and len(name) <= LONGEST_NAME):
                raise ValueError(f"{name[:40]!a} is no name of a parameter: letters, digits "
                                 f"and '_', at most {LONGEST_NAME}")
            if (size := float(np.max(np.abs(numbers)))) > LARGEST:
                raise ValueError(f"{name} {size:.3g}: at most {LARGEST:g}")
        return value

    @field_validator("effect")
    @classmethod
    def _is_known(cls, value: str) -> str:
        if value not in LAWS:
            raise ValueError(str(unknown_name("effect", value[:40], LAWS,
                                              f"known are {', '.join(LAWS)}")))
        return value


class Settings(_Part):
    """What is otherwise derived from the data."""

    band: float | None = Field(default=None, ge=1e-4, le=MAX_RIG_RATE / 2)
    """Cut-off of the filter of both sides of the balance (Hz)."""
    cutoff: float | None = Field(default=None, ge=1e-4, le=MAX_RIG_RATE / 2)
    """Cut-off of a Butterworth filter of the outputs before they are differentiated (Hz)."""
    decimate: int | None = Field(default=None, ge=2, le=1000)
    """Both sides by `scipy.signal.decimate` with this factor, in place of the band's filter."""
    gate: float = Field(default=0.0, ge=0.0, le=100.0)
    """Rows so near to a reversal are left out, in periods of the band; 0 keeps them."""
    standstill: float | None = Field(default=None, gt=0.0, le=LARGEST)
    """Speed below which the axis counts as at rest (m/s or rad/s)."""


class ModelAxis(_Part):
    """What axis a model is of, and how far it moved in the records."""

    motion: Motion
    input: InputQuantity
    travel: tuple[Finite, Finite]
    """Smallest and largest position (m or rad)."""
    largest_speed: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    """(m/s or rad/s)"""
    largest_input: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    """In the unit of the input."""


class RigModel(_Part):
    """What is believed of a rig before the comparison."""

    rig: str = Field(default="rig", pattern=r"^[A-Za-z0-9_.-]{1,64}$")
    terms: tuple[KnownTerm, ...] = Field(min_length=1, max_length=MAX_TERMS)
    settings: Settings = Settings()
    axis: ModelAxis | None = None
    """Written by an identification."""


DEFAULT_MODEL = RigModel(
    terms=(KnownTerm(effect="inertia"), KnownTerm(effect="viscous_friction")))
"""Inertia and viscous friction, both free."""


def load_rig_model(path: str | Path | None) -> RigModel:
    """Return the model in a file, or the default model.

    Raises
    ------
    UsageError
        The file cannot be read or is no model of a rig; one line says where and why.
    """
    if path is None:
        return DEFAULT_MODEL
    data = load_yaml(Path(path))
    if not isinstance(data, dict) or "terms" not in data:
        raise UsageError(f"{path}: no model of a rig: expected 'rig:' and 'terms:': {SEE}")
    model = validated(RigModel.model_validate, data, str(path), "model", SEE)
    for term in model.terms:
        _check_parameters(term, str(path))
    return model


def _check_parameters(term: KnownTerm, source: str) -> None:
    law = LAWS[term.effect]
    allowed = law.shape + (("amplitude", "phase") if law.periodic else law.coefficients)
    for name in term.parameters:
        if name not in allowed:
            raise unknown_name(f"parameter of {term.effect}", name, allowed,
                               f"{source}: it has {', '.join(allowed)}")
    missing = [name for name in law.shape if name not in term.parameters]
    if missing:
        raise UsageError(f"{source}: {term.effect} lacks {missing[0]!r}: give a value; only "
                         "parameters in which the input is linear may be left free")
    if law.periodic and ("amplitude" in term.parameters) != ("phase" in term.parameters):
        raise UsageError(f"{source}: {term.effect}: give amplitude and phase, or neither")


def dump_rig_model(model: RigModel, comment: str = "") -> str:
    """Return the YAML text of a model."""
    dumped = model.model_dump(mode="json", exclude_defaults=True)
    data: dict[str, object] = {
        "rig": model.rig, "terms": [_plain(term) for term in model.terms],
        **{key: dumped[key] for key in ("axis", "settings") if key in dumped}}
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=90,
                                 default_flow_style=None)


def _plain(term: KnownTerm) -> dict[str, object]:
    entry: dict[str, object] = {"effect": term.effect}
    if term.parameters:
        entry["parameters"] = {name: float(f"{value:.8g}")
                               for name, value in term.parameters.items()}
        entry["tolerance"] = float(f"{term.tolerance:.3g}")
    if term.estimate:
        entry["estimate"] = {name: [float(f"{value:.6g}") for value in values]
                             for name, values in term.estimate.items()}
    return entry
