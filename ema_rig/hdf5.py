"""HDF5 and MATLAB files of version 7.3 as columns: datasets, structures, tables, timetables.

Only what the file itself holds is read: links to other files, external storage and virtual
datasets, by which a file could show any other one of this machine, are not followed. A MATLAB
object is a row of numbers that points into one block of metadata: names, classes, and for each
object which cell holds which property.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ema_record.errors import InvalidRecordError, RecordError, UsageError, library
from ema_rig.table import (
    MAX_COLUMNS,
    MAX_FILE_BYTES,
    MAX_ROWS,
    Table,
    check_shape,
    real_array,
    said_by,
)

MAX_NAMES, MAX_DEPTH = 10_000, 8
"""Datasets of a file that are listed, and groups within one another, at most."""
MAX_RATIO = 2000
"""Of the bytes of a dataset to those that are stored; deflate packs 1032 into one."""
CLASS = "MATLAB_class"
NUMERIC = frozenset({"double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32",
                     "int64", "uint64", "logical"})
"""Classes of MATLAB that are arrays of numbers."""
_TABLES = ("table", "timetable")
_MAGIC = 0xDD000000
_MAX_METADATA = 64 << 20
_FIRST = 2
"""Cells of the subsystem before those with properties."""


@dataclass(frozen=True, kw_only=True)
class Leaf:
    """A column or a matrix that is there and not read yet."""

    shape: tuple[int, ...]
    read: Callable[[], np.ndarray]
    unit: str = ""
    problem: str = ""
    """Why it cannot be read, and what to do; empty where it can."""


def read_hdf5(path: Path, needed: Sequence[str | int] | None) -> Table:
    """Return the datasets of a file that are needed; those within groups as ``group.name``.

    Raises
    ------
    UsageError
        h5py is not installed; a column by number.
    InvalidRecordError
        Damaged, too large, or a dataset that is no array of numbers.
    """
    h5py = library("h5py", f"{path}: HDF5 (also MATLAB 7.3)", "save the data as CSV", "export")
    try:
        with h5py.File(path, "r") as file:
            return _table(dict(_leaves(file, str(path))), path, needed)
    except (RecordError, UsageError):
        raise
    except Exception as error:  # noqa: BLE001  (whatever HDF5 trips over in a damaged file)
        raise InvalidRecordError(f"{path}: no HDF5 file, or damaged ({said_by(error)}): save it "
                                 "again") from None


def _table(leaves: dict[str, Leaf], path: Path, needed: Sequence[str | int] | None) -> Table:
    """Return the columns that are needed, within the bounds of what is read."""
    if any(isinstance(name, int) for name in needed or ()):
        raise UsageError(f"{path}: columns of an HDF5 file have names, not numbers: it holds "
                         f"{', '.join(list(leaves)[:12])}")
    wanted = [name for name, leaf in leaves.items() if not leaf.problem] if needed is None else [
        name for name in leaves
        if any(one == name or str(one).startswith(f"{name}[") for one in needed)]
    total = 0
    for name in wanted:
        leaf = leaves[name]
        if leaf.problem:
            raise InvalidRecordError(f"{path}: {name} {leaf.problem}")
        size = sorted(int(n) for n in (*leaf.shape, 1))
        check_shape(size[-1], size[-2], f"{path}: {name}")
        total += 8 * int(np.prod(size, dtype=object))
    if total > MAX_FILE_BYTES:
        raise InvalidRecordError(f"{path}: {total} bytes once read, at most {MAX_FILE_BYTES}: "
                                 "import a part of it")
    columns = {name: np.atleast_1d(real_array(leaf.read(), f"{path}: {name}"))
               if name in wanted else np.empty((0, 0)) for name, leaf in leaves.items()}
    return Table(columns=columns, source=str(path),
                 units={name: leaf.unit for name, leaf in leaves.items() if leaf.unit})


def _leaves(file: Any, source: str) -> Iterator[tuple[str, Leaf]]:
    """Yield what a file holds by its name, the groups one after the other."""
    objects = MatlabObjects(file) if "#subsystem#" in file else None
    groups, count = [("", file, 0)], 0
    while groups:
        prefix, group, depth = groups.pop(0)
        for key in group:
            count += 1
            if count > MAX_NAMES:
                raise InvalidRecordError(f"{source}: more than {MAX_NAMES} datasets: save those "
                                         "that matter in a file of their own")
            found = own(group, key)
            if found is None or key in ("#refs#", "#subsystem#"):
                continue
            name = f"{prefix}{key}"
            if not hasattr(found, "shape"):
                if depth < MAX_DEPTH:
                    groups.append((f"{name}.", found, depth + 1))
                continue
            yield from _of_dataset(name, found, objects)


def own(group: Any, key: str) -> Any:
    """Return a member of a group that lies in this file, None for a link to elsewhere."""
    import h5py

    if not isinstance(group.get(key, getlink=True), h5py.HardLink):
        return None
    return group[key]


def _of_dataset(
    name: str, found: Any, objects: MatlabObjects | None
) -> Iterator[tuple[str, Leaf]]:
    """Yield what one dataset holds: itself, its fields, or the columns of a MATLAB table."""
    kind = text_of(found.attrs.get(CLASS, ""))
    if kind in _TABLES and objects is not None:
        for column, leaf in table_columns(objects, found):
            yield f"{name}.{column}", leaf
    elif found.dtype.names is not None and found.ndim == 1 and not kind:
        for field in found.dtype.names:
            shape = (*found.shape, *found.dtype[field].shape)
            yield f"{name}.{field}", Leaf(
                shape=shape, read=partial(found.__getitem__, field),
                problem=trouble(found, found.dtype[field].base, len(shape), ""))
    else:
        yield name, plain_leaf(found, kind)


def plain_leaf(found: Any, kind: str, unit: str = "") -> Leaf:
    """Return one dataset of numbers; that of a MATLAB class lies the other way."""
    unit = unit or text_of(found.attrs.get("units", found.attrs.get("unit", "")))
    return Leaf(shape=found.shape, unit=unit[:20],
                read=lambda: np.asarray(found[()].T if kind else found[()]),
                problem=trouble(found, found.dtype, found.ndim, kind))


def trouble(found: Any, dtype: np.dtype, dimensions: int, kind: str) -> str:
    """Return why a dataset is not read, empty where it is."""
    if kind and kind not in NUMERIC:
        return (f"is a MATLAB {kind[:40]}, expected an array of numbers, a structure, a table or "
                "a timetable: save its values by double(...)")
    if found.external or found.is_virtual:
        return "lies in another file, which is not read: save it in this one"
    if found.attrs.get("MATLAB_empty", 0) or 0 in found.shape:
        return "is empty: name another column"
    if found.size * found.dtype.itemsize > MAX_RATIO * max(found.id.get_storage_size(), 64):
        return f"claims {found.size} values and stores hardly any: name another column"
    if dtype.kind not in "fiub" or dimensions > 2:
        return (f"has {dimensions} dimensions of {str(dtype)[:40]}, expected one or two of real "
                "numbers: save it as such, or name another column")
    return ""


def text_of(value: Any) -> str:
    """Return an attribute as text."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, str) else ""


class MatlabObjects:
    """The objects of a file.

    Parameters
    ----------
    file : with the group ``#subsystem#``.
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
