"""The model of a kit as arrays in the cache: it is read and checked once, then only looked up.

What is kept is a model that `load_model` found good, beside the SHA-256 of the file that it was
read from. It holds for that file, this version of the software, its inputs and these fields
alone; whatever else lies in its place, damaged or of another layout, counts as absent. It judges
as the file does (the numbers are the same doubles), but is not written to a file again: its lists
are arrays.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import types
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ema_prognostics.cascade.find import Cascade
from ema_prognostics.cascade.lines import DERIVED
from ema_prognostics.cascade.model_body import Part, ViewPart
from ema_prognostics.cascade.model_file import (
    MAX_BYTES,
    Body,
    TrainedModel,
    load_model,
    paper_of,
)
from ema_record.actuator_type import is_of_another_actuator
from ema_record.array_cache import cache_directory, load, save
from ema_record.files import read_bounded
from ema_record.kit import CASCADE, kit_path
from ema_record.version import VERSION

MOST_KEPT = 8
"""Kits whose models are kept."""
UNUSABLE = (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError)
"""What a kept model raises that is not of these fields."""


class LazyCascades(Mapping[str, Cascade]):
    """The cascades of views that are known to be good, each built when it is asked for."""

    def __init__(self, views: Mapping[str, ViewPart]) -> None:
        self._views, self._built = views, dict[str, Cascade]()

    def __getitem__(self, name: str) -> Cascade:
        if name not in self._built:
            self._built[name] = Cascade(self._views[name])
        return self._built[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._views)

    def __len__(self) -> int:
        return len(self._views)


def kept_model(path: str | Path | None = None) -> TrainedModel:
    """Return the model of a file, as `load_model` does; that of a kit out of the cache."""
    if path is not None:
        return load_model(path)
    place = kit_path(CASCADE)
    found = _hash_of(place)
    if found is None:  # which says why
        return load_model()
    name = f"model_{hashlib.sha256(os.fsencode(place.resolve())).hexdigest()[:32]}"
    kept = _unpacked(name, found)
    if kept is not None and not is_of_another_actuator(kept.body.actuator):
        return kept
    model = load_model()
    if _hash_of(place) == found:  # the very file that was read
        save(name, _packed(model, found))
        _forget_old()
    return model


def _forget_old() -> None:
    """Remove all kept models but the newest: kits come and go, 2 MB each."""
    with contextlib.suppress(OSError):
        files = sorted(cache_directory().glob("model_*.npz"), key=lambda f: f.stat().st_mtime_ns)
        for path in files[:-MOST_KEPT]:
            path.unlink(missing_ok=True)


def _hash_of(path: Path) -> str | None:
    try:
        return hashlib.sha256(read_bounded(path, MAX_BYTES)).hexdigest()
    except (OSError, ValueError):
        return None


def _layout(file: str) -> list[str]:
    """Return what a kept model must have been kept for."""
    return [file, VERSION, *DERIVED]


def _packed(model: TrainedModel, file: str) -> dict[str, np.ndarray]:
    """Return a model as one array of all its numbers, and a tree of where they are, as JSON.

    In the tree a list is ``["list", ...]``, and one of numbers ``["array", start, shape]``.
    """
    numbers: list[np.ndarray] = [np.empty(0)]

    def packed(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: packed(inner) for name, inner in value.items()}
        if not isinstance(value, list | tuple):
            return value
        array = _numbers_in(value)
        if array is None:
            return ["list", *(packed(inner) for inner in value)]
        start = sum(part.size for part in numbers)
        numbers.append(array.ravel())
        return ["array", start, list(array.shape)]

    tree = {"layout": _layout(file), "sha256": model.sha256, "training": model.training,
            "body": packed(model.body.model_dump(exclude={"training"}))}
    return {"tree": np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8),
            "numbers": np.concatenate(numbers)}


def _numbers_in(value: list[Any] | tuple[Any, ...]) -> np.ndarray | None:
    """Return lists of floats, or of such lists of one length, as an array; None: others."""
    rows = value if value and isinstance(value[0], list) else [value]
    even = all(isinstance(row, list | tuple) and len(row) == len(rows[0]) > 0 for row in rows)
    if not even or any(type(v) is not float for row in rows for v in row):
        return None
    return np.array(value)


def _unpacked(name: str, file: str) -> TrainedModel | None:
    """Return the model that is kept for the file of that hash, None: there is none."""
    arrays = load(name)
    try:
        if arrays is None:
            return None
        tree, numbers = json.loads(arrays["tree"].tobytes()), arrays["numbers"]
        if tree["layout"] != _layout(file) or numbers.dtype != float or numbers.ndim != 1:
            return None
        body = _built(Body, tree["body"] | {"training": tree["training"]}, numbers)
        return TrainedModel(
            body=body, cascades=LazyCascades(body.views), sha256=str(tree["sha256"]),
            paper=None if body.paper is None else paper_of(body.paper))
    except UNUSABLE:
        return None


def _built(kind: Any, value: Any, numbers: np.ndarray) -> Any:
    """Return a tree as what a field of type `kind` holds."""
    options, origin = typing.get_args(kind), typing.get_origin(kind)
    if origin in (types.UnionType, typing.Union):
        return None if value is None else _built(options[0], value, numbers)
    if isinstance(kind, type) and issubclass(kind, Part):
        if set(value) != set(kind.model_fields):
            raise ValueError("other fields")
        return kind.model_construct(**{
            name: value[name] if name == "training" else _built(part.annotation, value[name],
                                                                numbers)
            for name, part in kind.model_fields.items()})
    if origin is dict:
        return {name: _built(options[1], inner, numbers) for name, inner in value.items()}
    if not isinstance(value, list):
        return value
    if value[0] == "list":
        return [_built(None, inner, numbers) for inner in value[1:]]
    _, start, shape = value
    end = start + int(np.prod(shape))
    if not 0 <= start <= end <= len(numbers):
        raise ValueError("beyond the numbers")
    return numbers[start:end].reshape(shape)
