"""The model file: plain JSON with version and hash, checked before anything is used.

``{"format": "ema_phm model", "version": 6, "sha256": ..., "body": {...}}``; the hash is that of
the body as canonical JSON (sorted keys, no spaces). It tells a damaged file, not a forged one:
whoever writes a body can write its hash. Arrays are nested lists, rounded to seven digits, so
the same training writes the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic_core import from_json

from ema_prognostics.cascade.find import Cascade
from ema_prognostics.cascade.model_body import (
    DiscrepancyPart,
    NetworkPart,
    Part,
    View,
    ViewPart,
)
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.paper.cascade import ANN_B_INPUTS, FAULTS, PaperCascade
from ema_prognostics.paper.features import ANN_A_INPUTS
from ema_record.actuator_type import actuator_hash, is_of_another_actuator
from ema_record.errors import ModelError, validated
from ema_record.files import new_file, read_bounded
from ema_record.kit import CASCADE, kit_name, kit_path

FORMAT = "ema_phm model"
VERSION = 6
MAX_BYTES = 16 << 20
BODY = '"body":'
NO_NUMBERS = ("NaN", "Infinity")
"""What stands in no JSON, and some readers take for numbers."""


class PaperPart(Part):
    """The paper's networks."""

    ann_a: NetworkPart
    ann_b: dict[Literal["turn_short", "rotor_eccentricity"], NetworkPart]


class Body(Part):
    """The whole body."""

    views: dict[Annotated[str, Field(pattern="^(step|extended)/(fleet|baseline)$")], ViewPart]
    """By ``<kind>/<view>``, e.g. ``extended/fleet``."""
    paper: PaperPart | None
    discrepancy: dict[Literal["step", "extended"], DiscrepancyPart] = Field(default={})
    """By kind of test; empty: nothing is known of it."""
    actuator: Annotated[str, Field(pattern="^([0-9a-f]{16})?$")] = ""
    """Type that it was trained for, see `actuator_hash`; empty: a file of before it was told."""
    training: dict[str, Any]

    def plain(self) -> dict[str, Any]:
        """Return the body as plain values, as the file holds it."""
        return self.model_dump(mode="json", exclude=None if self.actuator else {"actuator"})

    @classmethod
    def parse(cls, data: object, where: str) -> Body:
        """Return the body of `data`, plain values or JSON text; ModelError in one line."""
        read = cls.model_validate_json if isinstance(data, str) else cls.model_validate
        return validated(read, data, where, "body", "train again", kind=ModelError)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainedModel:
    """Everything that a diagnosis needs.

    Attributes
    ----------
    body : what the file holds.
    cascades : by kind of test and view, e.g. ``extended/fleet``.
    paper : the paper's literal cascade, or None.
    sha256 : hash of the body.
    """

    body: Body
    cascades: Mapping[str, Cascade] = field(repr=False)
    paper: PaperCascade | None
    sha256: str

    @property
    def training(self) -> dict[str, Any]:
        """How it was trained and what the held-back units gave; plain values."""
        return self.body.training

    def cascade(self, kind: ProfileKind, view: View) -> Cascade | None:
        """Return the cascade for a kind of test, None where it was not trained."""
        return self.cascades.get(f"{kind}/{view}")


def model_of(body: Body, where: str = "model", sha256: str = "") -> TrainedModel:
    """Return the model of a body; ModelError if the parts do not fit the software.

    `sha256` is its hash where that is known already.
    """
    try:
        cascades = {name: Cascade(part) for name, part in body.views.items()}
        paper = None if body.paper is None else paper_of(body.paper)
    except ValueError as error:
        raise ModelError(f"{where}: {error}: train again") from None
    return TrainedModel(body=body, cascades=cascades, paper=paper,
                        sha256=sha256 or _hash(_canonical(body.plain())))


def paper_of(part: PaperPart) -> PaperCascade:
    """Return the paper's networks at work; ValueError if they do not fit."""
    part.ann_a.check_size(len(ANN_A_INPUTS), len(FAULTS))
    if set(part.ann_b) != set(FAULTS):
        raise ValueError("paper: one ann_b a fault is needed")
    for fault in FAULTS:
        part.ann_b[fault].check_size(len(ANN_B_INPUTS[fault]), 3)
    return PaperCascade(
        ann_a=part.ann_a.build(), ann_b={name: b.build() for name, b in part.ann_b.items()}
    )


def _canonical(body: object) -> str:
    return json.dumps(body, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def model_text(model: TrainedModel) -> str:
    """Return the model file as text."""
    text = _canonical(model.body.plain())
    return (
        f'{{"format":"{FORMAT}","version":{VERSION},"sha256":"{_hash(text)}",\n"body":{text}}}\n'
    )


def save_model(model: TrainedModel, path: str | Path) -> Path:
    """Write a new model file; OutputError if there is one already."""
    target = Path(path)
    with new_file(target) as temporary:
        temporary.write_text(model_text(model), encoding="utf-8")
    return target


def load_model(path: str | Path | None = None) -> TrainedModel:
    """Return the model of a file, default the present kit's; ModelError in one line.

    One that was trained for another type of actuator than the present kit's is refused.
    """
    target = kit_path(CASCADE) if path is None else Path(path)
    if path is None and not target.exists():
        raise ModelError(f"{kit_name()} has no {CASCADE}: 'ema commission' makes it from records "
                         "of healthy units, 'ema train' from the description alone")
    try:
        text = read_bounded(target, MAX_BYTES).decode("utf-8")
    except UnicodeDecodeError:
        raise ModelError(f"{target}: not UTF-8 text: not a model file") from None
    except OSError as error:
        raise ModelError(
            f"{target}: {error.strerror or error}: 'ema train --out FILE' makes one"
        ) from None
    model = parse_model(text, str(target))
    if is_of_another_actuator(model.body.actuator):
        raise ModelError(
            f"{target}: trained for the actuator {model.body.actuator!r}, {kit_name()} describes "
            f"{actuator_hash()!r}: give that actuator's kit (--kit DIR), or train for this one "
            "('ema commission', 'ema train')")
    return model


def parse_model(text: str, where: str) -> TrainedModel:
    """Return the model that `text` holds; `where` names it in errors."""
    if (model := _as_written(text, where)) is not None:
        return model
    try:
        data = from_json(text, allow_inf_nan=False)
    except ValueError as error:
        raise ModelError(
            f"{where}: not JSON ({str(error)[:80]}): train again with 'ema train'"
        ) from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ModelError(f"{where}: not a model file of this software: use 'ema train'")
    if data.get("version") != VERSION:
        raise ModelError(
            f"{where}: version {str(data.get('version'))[:20]}, this software reads {VERSION}: "
            "train again with 'ema train'"
        )
    body, named = data.get("body"), data.get("sha256")
    try:
        found = _hash(_canonical(body))
    except ValueError:
        raise ModelError(f"{where}: holds a number beyond all (1e999): it was changed or damaged, "
                         "train again") from None
    if found != named:
        raise ModelError(
            f"{where}: the hash is {found[:12]}..., the file says "
            f"{str(named)[:12]}...: it was changed or damaged, train again"
        )
    return model_of(Body.parse(body, where), where, found)


def _as_written(text: str, where: str) -> TrainedModel | None:
    """Return the model of a file that stands as `model_text` writes it, None if it does not.

    The body is then hashed as it stands and read once, straight into its fields.
    """
    head, key, rest = text.rstrip().partition(BODY)
    body = rest.removesuffix("}")
    if body == rest or any(word in body for word in NO_NUMBERS):
        return None
    try:
        header = from_json(f"{head}{key}null}}", allow_inf_nan=False)
    except ValueError:
        return None
    found = _hash(body)
    if header != {"format": FORMAT, "version": VERSION, "sha256": found, "body": None}:
        return None
    return model_of(Body.parse(body, where), where, found)


def stated_sha256(path: Path) -> str:
    """Return the hash that a model file states, unchecked; empty where it states none."""
    with path.open("rb") as file:
        found = re.search(rb'"sha256":"([0-9a-f]{64})"', file.read(400))
    return "" if found is None else found[1].decode()
