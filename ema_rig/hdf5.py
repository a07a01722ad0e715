"""HDF5 and MATLAB files of version 7.3 as columns: datasets, structures, tables, timetables.

Only what the file itself holds is read: links to other files, external storage and virtual
datasets, by which a file could show any other one of this machine, are not followed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ema_record.errors import InvalidRecordError, RecordError, UsageError
from ema_rig.table import MAX_FILE_BYTES, Table, check_shape, real_array

if TYPE_CHECKING:
    from ema_rig.mcos import MatlabObjects

MAX_NAMES, MAX_DEPTH = 10_000, 8
"""Datasets of a file that are listed, and groups within one another, at most."""
MAX_RATIO = 2000
"""Of the bytes of a dataset to those that are stored; deflate packs 1032 into one."""
CLASS = "MATLAB_class"
_PLAIN = frozenset({"double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32",
                    "int64", "uint64", "logical"})
_TABLES = ("table", "timetable")


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
    try:
        import h5py
    except ImportError:
        raise UsageError(f"{path}: HDF5 (also MATLAB 7.3) needs the package h5py, which is not "
                         "installed: pip install 'ema_phm[export]', or save the data as CSV"
                         ) from None
    try:
        with h5py.File(path, "r") as file:
            return _table(dict(_leaves(file, str(path))), path, needed)
    except (RecordError, UsageError):
        raise
    except Exception as error:  # noqa: BLE001  (whatever HDF5 trips over in a damaged file)
        text = " ".join(str(error).split())[:80]
        raise InvalidRecordError(f"{path}: no HDF5 file, or damaged ({text}): save it again"
                                 ) from None


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
    from ema_rig.mcos import MatlabObjects

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
        from ema_rig.mcos import table_columns

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
    if kind and kind not in _PLAIN:
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
