"""The model file: plain JSON with version and hash, checked before anything is used.

``{"format": "ema_phm model", "version": 1, "sha256": ..., "body": {...}}``; the hash is that of
the body as canonical JSON (sorted keys, no spaces). Arrays are nested lists, rounded to eight
digits, so the same training writes the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ema_prognostics.cascade import Cascade
from ema_prognostics.model_body import Body, body_of, cascade_of, paper_of, plant_from
from ema_prognostics.paper_cascade import PaperCascade
from ema_prognostics.torque_lines import Plant
from ema_record.errors import ModelError, OutputError
from ema_record.resources import share_path

FORMAT = "ema_phm model"
VERSION = 1
SHIPPED = "config/models/cascade.json"
MAX_BYTES = 16 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """Everything that a diagnosis needs.

    Attributes
    ----------
    cascades : by kind of test, ``step`` and ``extended``.
    paper : the paper's literal cascade, or None.
    plant : constants of the actuator that the features use.
    training : how it was trained and what the held-out fleet gave; plain values.
    sha256 : hash of the body.
    """

    cascades: dict[str, Cascade]
    paper: PaperCascade | None
    plant: Plant
    training: dict[str, Any]
    sha256: str = ""


def _canonical(body: object) -> str:
    return json.dumps(body, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def model_text(model: Model) -> str:
    """Return the model file as text."""
    text = _canonical(body_of(model.cascades, model.paper, model.plant, model.training))
    return (
        f'{{"format":"{FORMAT}","version":{VERSION},"sha256":"{_hash(text)}",\n"body":{text}}}\n'
    )


def save_model(model: Model, path: str | Path) -> Path:
    """Write a new model file; OutputError if there is one already."""
    target = Path(path)
    text = model_text(model)
    try:
        with target.open("x", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError:
        raise OutputError(f"{target}: exists already: choose another name") from None
    except OSError as error:
        raise OutputError(
            f"{target}: {error.strerror or error}: choose a place that can be written to"
        ) from None
    return target


def load_model(path: str | Path | None = None) -> Model:
    """Return the model of a file, default the shipped one; ModelError in one line."""
    try:
        target = share_path(SHIPPED) if path is None else Path(path)
        size = target.stat().st_size
        if size > MAX_BYTES:
            raise ModelError(f"{target}: {size} bytes, at most {MAX_BYTES}: not a model file")
        text = target.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ModelError(f"{path}: not UTF-8 text: not a model file") from None
    except OSError as error:
        raise ModelError(
            f"{path or SHIPPED}: {error.strerror or error}: 'ema train --out FILE' makes one"
        ) from None
    return parse_model(text, str(target))


def parse_model(text: str, where: str) -> Model:
    """Return the model that `text` holds; `where` names it in errors."""
    try:
        data = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
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
    body = data.get("body")
    found = _hash(_canonical(body))
    if found != data.get("sha256"):
        raise ModelError(
            f"{where}: the hash is {found[:12]}..., the file says "
            f"{str(data.get('sha256'))[:12]}...: it was changed or damaged, train again"
        )
    parsed = Body.parse(body, where)
    return Model(
        cascades={kind: cascade_of(c, f"{where}: {kind}") for kind, c in parsed.cascades.items()},
        paper=None if parsed.paper is None else paper_of(parsed.paper, f"{where}: paper"),
        plant=plant_from(parsed.plant, where),
        training=parsed.training, sha256=found,
    )


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a number")
