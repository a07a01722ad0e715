"""Tables and timetables in MATLAB files of version 7.3: what the subsystem of the file holds.

An object in such a file is a row of numbers that points into one block of metadata: names,
classes, and for each object which cell holds which property.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from ema_rig.hdf5 import CLASS, Leaf, plain_leaf, text_of
from ema_rig.table import MAX_COLUMNS, MAX_ROWS

_MAGIC = 0xDD000000
_MAX_METADATA = 64 << 20
_FIRST = 2
"""Cells of the subsystem before those with properties."""


class MatlabObjects:
    """The objects of a file.

    Parameters
    ----------
    file : h5py.File
        With the group ``#subsystem#``.

    """

    def __init__(self, file: Any) -> None:
        """Read the metadata, no property."""
        self.file = file
        self.cells = file["#subsystem#"]["MCOS"][()].ravel()
        block = file[self.cells[0]]
        if block.size > _MAX_METADATA:
            raise ValueError(f"{block.size} bytes of metadata")
        data = block[()].astype(np.uint8).tobytes()
        at = [int(v) for v in np.frombuffer(data, "<i4", 8, 8)]
        self._names = [part.decode("ascii", "replace") for part in data[40:at[0]].split(b"\0")
                       if part]
        self._classes, saved, objects, normal = (
            np.frombuffer(data[a:b], "<i4") for a, b in zip(at[:4], at[1:5]))
        self._objects = objects.reshape(-1, 6)
        self._saved, self._normal = _blocks(saved), _blocks(normal)

    def read(self, dataset: Any) -> tuple[str, dict[str, Any]]:
        """Return the class of an object and its properties: datasets, groups or numbers."""
        if not is_object(dataset):
            raise ValueError("no MATLAB object")
        head = dataset[()].ravel()
        count = int(np.prod(head[2:2 + int(head[1])].astype(object)))
        if count != 1:
            raise ValueError(f"an array of {count} MATLAB objects")
        _, _, _, saved, normal, _ = self._objects[int(head[-2])]
        name = self._names[self._classes.reshape(-1, 4)[int(head[-1]), 1] - 1]
        found: dict[str, Any] = {}
        for key, kind, value in (self._saved[saved] if saved else self._normal[normal]):
            found[self._names[key - 1]] = int(value) if kind != 1 else \
                self.file[self.cells[_FIRST + int(value)]]
        return name, found

    def cell(self, dataset: Any) -> list[Any]:
        """Return what a cell array holds, as datasets and groups."""
        if not isinstance(dataset.dtype, np.dtype) or dataset.dtype != object \
                or dataset.size > MAX_COLUMNS:
            return []
        return [self.file[reference] for reference in dataset[()].ravel()]

    def texts(self, dataset: Any) -> list[str]:
        """Return what a cell array of characters holds."""
        return [_characters(item) for item in self.cell(dataset)]


def is_object(dataset: Any) -> bool:
    """Return whether a dataset stands for an object."""
    return bool(hasattr(dataset, "shape") and dataset.dtype == np.uint32
                and 5 <= dataset.size < 64 and dataset[()].ravel()[0] == _MAGIC)


def _blocks(values: np.ndarray) -> list[np.ndarray]:
    """Return the properties of each object, shape (n, 3): name, kind, value."""
    found, at = [], 0
    while at < len(values):
        count = max(int(values[at]), 0)
        found.append(values[at + 1:at + 1 + 3 * count].reshape(-1, 3))
        at += 1 + 3 * count
        at += at % 2
    return found


def _characters(dataset: Any) -> str:
    if text_of(dataset.attrs.get(CLASS, "")) != "char" or dataset.attrs.get("MATLAB_empty", 0) \
            or dataset.size > 2048:
        return ""
    return "".join(chr(int(code)) for code in dataset[()].ravel())


def table_columns(objects: MatlabObjects, dataset: Any) -> Iterator[tuple[str, Leaf]]:
    """Yield the columns of a table or a timetable by name, its times (s) first."""
    name, own = objects.read(dataset)
    if name == "timetable":
        own = dict(own["any"].items())
        rows = min(int(own["numRows"][()].ravel()[0]), MAX_ROWS + 1)
        label = (objects.texts(own["dimNames"]) or ["Time"])[0]
        yield label, Leaf(shape=(rows,), unit="s",
                          read=partial(_row_times, objects, own["rowTimes"], rows))
        names, units = objects.texts(own["varNames"]), objects.texts(own["varUnits"])
    else:
        names = objects.texts(own["varnames"])
        units = objects.texts(own["props"]["VariableUnits"])
    units += [""] * (len(names) - len(units))
    for label, unit, data in zip(names, units, objects.cell(own["data"])):
        yield label, _variable(objects, data, unit)


def _variable(objects: MatlabObjects, data: Any, unit: str) -> Leaf:
    """Return one column of a table: numbers, times in seconds, or what is not read."""
    kind = text_of(data.attrs.get(CLASS, ""))
    own: dict[str, Any] = {}
    if is_object(data):
        kind, own = objects.read(data)
    if kind in ("duration", "datetime"):
        stored = own["millis" if kind == "duration" else "data"]
        return Leaf(shape=stored.shape, unit="s", read=partial(_seconds, kind, own))
    return plain_leaf(data, kind or "object", unit)


def _row_times(objects: MatlabObjects, stored: Any, rows: int) -> np.ndarray:
    """Return the times of the rows (s): as stored, or of an even rate from their origin."""
    if hasattr(stored, "shape"):
        kind, own = objects.read(stored)
        return _seconds(kind, own)
    kind, own = objects.read(stored["origin"])
    start = float(_seconds(kind, own).ravel()[0]) if kind == "duration" else 0.0
    if int(stored["specifiedAsRate"][()].ravel()[0]):
        return start + np.arange(rows) / float(stored["sampleRate"][()].ravel()[0])
    kind, own = objects.read(stored["stepSize"])
    if kind != "duration":
        raise ValueError(f"rows every {kind}")
    return start + np.arange(rows) * float(_seconds(kind, own).ravel()[0])


def _seconds(kind: str, own: dict[str, Any]) -> np.ndarray:
    """Return a duration, or a datetime from its first one, in seconds."""
    stored = own["millis" if kind == "duration" else "data"]
    if stored.size > MAX_ROWS:
        raise ValueError(f"{stored.size} times")
    values = stored[()].T
    if values.dtype.names is None:
        values = values.astype(np.float64)
        return np.asarray(1e-3 * (values if kind == "duration" else values - values.ravel()[0]))
    whole, part = values["real"], values["imag"]  # a sum of two, to less than a microsecond
    return np.asarray(1e-3 * ((whole - whole.ravel()[0]) + (part - part.ravel()[0])))
