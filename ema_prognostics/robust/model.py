"""The cascade as data: networks, thresholds, interval widths, guard; JSON with a hash.

Plain arrays only. A file of another format, version or hash is refused before use.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ema_prognostics.network import Network
from ema_prognostics.robust.features import Kind
from ema_record.errors import ModelError, OutputError
from ema_record.resources import share_path

FORMAT = "ema-robust-cascade"
VERSION = 1
MAX_BYTES = 32 << 20
MAX_FEATURES = 400
MAX_HIDDEN = 400
View = Literal["fleet", "baseline"]

Real = Annotated[float, Field(allow_inf_nan=False)]
Vector = Annotated[list[Real], Field(max_length=4000)]
Matrix = Annotated[list[Vector], Field(max_length=2 * MAX_FEATURES)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class NetworkData(_Part):
    """A perceptron with one hidden layer, inputs and outputs scaled."""

    hidden_weights: Matrix
    hidden_bias: Vector
    output_weights: Matrix
    output_bias: Vector
    output_law: Literal["logsig", "linear"]
    output_mean: Vector
    output_scale: Vector

    @model_validator(mode="after")
    def _shapes(self) -> NetworkData:
        d, h, k = len(self.hidden_weights), len(self.hidden_bias), len(self.output_bias)
        good = (
            d > 0 and 0 < h <= MAX_HIDDEN and k > 0
            and all(len(row) == h for row in self.hidden_weights)
            and len(self.output_weights) == h and all(len(r) == k for r in self.output_weights)
            and len(self.output_mean) == k and len(self.output_scale) == k
        )
        if not good:
            raise ValueError("the shapes of the layers do not fit together")
        return self

    def build(self) -> Network:
        """Return the network as arrays."""
        d = len(self.hidden_weights)
        return Network(
            input_mean=np.zeros(d), input_scale=np.ones(d),
            hidden_weights=np.array(self.hidden_weights),
            hidden_bias=np.array(self.hidden_bias),
            output_weights=np.array(self.output_weights), output_bias=np.array(self.output_bias),
            output_law=self.output_law, output_mean=np.array(self.output_mean),
            output_scale=np.array(self.output_scale),
        )


class SeverityData(_Part):
    """How much: a network on asinh(severity / unit), and half widths of the 90 % interval."""

    network: NetworkData
    unit: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    edges: Vector
    """Bounds between bins of the predicted value, ascending."""
    half_width: Vector
    """Of each bin, in the network's output."""
    upper: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    """Largest severity trained on."""

    @model_validator(mode="after")
    def _bins(self) -> SeverityData:
        if len(self.half_width) != len(self.edges) + 1:
            raise ValueError("one half width a bin is needed")
        return self


class GuardData(_Part):
    """What the record must look like, given the features that faults move."""

    drivers: list[str] = Field(max_length=MAX_FEATURES)
    checked: list[str] = Field(max_length=MAX_FEATURES)
    mean: NetworkData
    scale: NetworkData
    limit: Vector
    """Largest usual |residual| / scale of each checked feature."""


class ViewData(_Part):
    """The cascade of one kind of test, with or without a baseline."""

    names: list[str] = Field(max_length=MAX_FEATURES)
    center: Vector
    spread: Vector
    """Of the healthy fleet, of each feature (in its unit)."""
    which: NetworkData
    threshold: Vector
    """Of the logit of each output, above which it is announced."""
    severity: dict[str, SeverityData]
    guard: GuardData | None

    @model_validator(mode="after")
    def _sizes(self) -> ViewData:
        d = len(self.names)
        if len(self.center) != d or len(self.spread) != d or min(self.spread, default=0.0) <= 0:
            raise ValueError("one centre and one positive spread a feature are needed")
        if len(self.which.hidden_weights) != d:
            raise ValueError("the first network does not fit the features")
        return self


class RobustModel(_Part):
    """A whole model file."""

    format: Literal["ema-robust-cascade"] = "ema-robust-cascade"
    version: Literal[1] = 1
    seed: int
    units: int
    views: dict[str, ViewData]
    """By ``<kind>/<view>``, e.g. ``extended/fleet``."""

    def view(self, kind: Kind, view: View) -> ViewData | None:
        """Return the cascade for a kind of test, None where it was not trained."""
        return self.views.get(f"{kind}/{view}")


def _digest(body: object) -> str:
    text = json.dumps(body, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def save_model(model: RobustModel, path: Path) -> None:
    """Write `model` to a new file; an existing one is never overwritten."""
    body = model.model_dump(mode="json")
    text = json.dumps({"sha256": _digest(body), "model": body}, separators=(",", ":"))
    if path.exists():
        raise OutputError(f"{path}: exists already: give another name")
    try:
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", dir=path.parent, prefix=".model-", delete=False
        ) as file:
            file.write(text + "\n")
        temporary = Path(file.name)
        temporary.chmod(0o644)
        try:
            os.link(temporary, path)  # fails where the name was taken meanwhile
        finally:
            temporary.unlink()
    except OSError as error:
        raise OutputError(
            f"{path}: {error.strerror or error}: the model was not written"
        ) from None


def load_robust_model(path: str | Path | None = None) -> RobustModel:
    """Return the model of a file, default the shipped one.

    Raises
    ------
    ModelError
        The file is missing, damaged, foreign, or of another version.
    """
    try:
        file = Path(path) if path is not None else share_path("config/models/robust.json")
        if file.stat().st_size > MAX_BYTES:
            raise ModelError(f"{file}: {file.stat().st_size} bytes, at most {MAX_BYTES}")
        data = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ModelError(
            f"{path or 'config/models/robust.json'}: {error.strerror or error}: "
            "train one with 'ema train'"
        ) from None
    except (ValueError, RecursionError):
        raise ModelError(f"{path}: not a JSON file: train a model with 'ema train'") from None
    body = data.get("model") if isinstance(data, dict) else None
    if not isinstance(body, dict) or body.get("format") != FORMAT:
        raise ModelError(f"{file}: not a model of the robust cascade: use one of 'ema train'")
    if body.get("version") != VERSION:
        raise ModelError(
            f"{file}: version {str(body.get('version'))[:20]}, this software reads {VERSION}: "
            "train it again"
        )
    try:
        if _digest(body) != data.get("sha256"):
            raise ModelError(f"{file}: the hash does not fit the contents: the file is damaged")
        return RobustModel.model_validate(body)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(p) for p in first["loc"])
        raise ModelError(f"{file}: {place}: {first['msg']}: the file is damaged") from None
    except ValueError:
        raise ModelError(f"{file}: values that are not finite: the file is damaged") from None
