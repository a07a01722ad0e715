"""Files of arrays as columns: MATLAB, NPZ, Parquet.

Of MATLAB plain numeric arrays, in structures too; those of 7.3 are HDF5. Arrays of objects in an
NPZ file would need pickle and are refused. Times of a Parquet file count from the first of them.
"""

from __future__ import annotations

import faulthandler
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from joblib import Parallel, delayed
from scipy.io import loadmat, whosmat

from ema_record.array_cache import DAMAGED
from ema_record.errors import InvalidRecordError, UsageError, library
from ema_rig.hdf5 import NUMERIC, read_hdf5
from ema_rig.table import (
    MAX_FILE_BYTES,
    CellBlock,
    Cells,
    Table,
    TextColumn,
    base_name,
    check_shape,
    chosen,
    real_array,
    said_by,
)

SECONDS = "s"
"""Unit of columns that are times by their type."""
T = TypeVar("T")
_HDF5 = b"\x89HDF"
_ARRAY, _COMPRESSED, _OPAQUE = 14, 15, 17
"""Of an element, one that is packed; of an array (MAT-File Format of MathWorks, level 5)."""


def read_mat(path: Path, needed: Sequence[str | int] | None) -> Table:
    """Return the variables of a MAT file that are needed; fields of a structure as ``a.b``.

    Raises
    ------
    InvalidRecordError
        Damaged, too large, or a variable that is no array of numbers.
    """
    with path.open("rb") as stream:
        head = stream.read(520)
    if _HDF5 in (head[:4], head[512:516]):
        return read_hdf5(path, needed)
    workers = Parallel(n_jobs=2, backend="loky")  # with one this process would be it
    try:
        with warnings.catch_warnings():  # where no process can be had, this one reads
            warnings.filterwarnings("ignore", message="Loky-backed parallel loops cannot")
            (found,) = workers([delayed(_read_level_5)(path, needed)])
    except BrokenExecutor:
        raise InvalidRecordError(f"{path}: damaged, what reads it crashed: save it again with "
                                 "'-v7'") from None
    return found


def _read_level_5(path: Path, needed: Sequence[str | int] | None) -> Table:
    """Read a file before 7.3, in a process of its own: a wrong type makes scipy crash."""
    faulthandler.disable()  # of that process: the caller says what happened
    if _holds_objects(path):  # which trip scipy, also over the arrays beside them
        raise InvalidRecordError(
            f"{path}: holds a MATLAB object (a table, a timetable, a string), which is read from "
            "a file of version 7.3 only: load it in MATLAB and save(..., '-v7.3')")
    listed = _by_scipy(lambda: whosmat(str(path)), path)
    contents = {name: (shape, kind) for name, shape, kind in listed}
    if needed is None:
        needed = [name for name, (_, kind) in contents.items() if kind in NUMERIC | {"struct"}]
    if any(isinstance(name, int) for name in needed):
        raise UsageError(f"{path}: columns of a MAT file have names, not numbers: it holds "
                         f"{', '.join(list(contents)[:12])}")
    wanted = sorted({base_name(str(name)) for name in needed} & contents.keys())
    total = 0
    for name in wanted:
        shape, kind = contents[name]
        if kind not in NUMERIC | {"struct"}:
            raise InvalidRecordError(f"{path}: {name} is a MATLAB {kind}, expected an array of "
                                     "numbers: convert it with double(...) and save again")
        if len(shape) == 2 and kind != "struct":
            check_shape(max(shape), min(shape), f"{path}: {name}")
        total += 8 * int(np.prod([int(n) for n in shape], dtype=object))
    if total > MAX_FILE_BYTES:
        raise InvalidRecordError(f"{path}: {total} bytes once read, at most {MAX_FILE_BYTES}: "
                                 "import a part of it")
    loaded = _by_scipy(
        lambda: loadmat(str(path), variable_names=wanted, chars_as_strings=False), path
    )
    columns: dict[str, np.ndarray] = {}
    for name in wanted:
        _collect(columns, name, loaded[name], path)
    for name in contents:  # named in errors, never read
        columns.setdefault(name, np.empty((0, 0)))
    return Table(columns=columns, source=str(path))


def _holds_objects(path: Path) -> bool:
    """Return whether a variable is of the class of objects, by the heads of all of them."""
    with path.open("rb") as stream:
        order = "<" if stream.read(128)[126:] == b"IM" else ">"
        while len(tag := stream.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            if kind not in (_ARRAY, _COMPRESSED):
                return False
            after = stream.tell() + size
            head = stream.read(min(size, 4096))
            if kind == _COMPRESSED:
                try:
                    head = zlib.decompressobj().decompress(head, 64)[8:]
                except zlib.error:
                    return False  # damaged, which scipy says
            flags = head[8:12]
            if len(flags) == 4 and struct.unpack(f"{order}I", flags)[0] & 0xFF == _OPAQUE:
                return True
            stream.seek(after)
    return False


def _by_scipy(read: Callable[[], T], path: Path) -> T:
    """Return what scipy reads; whatever it trips over in a damaged file is one error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return read()
        except Exception as error:  # noqa: BLE001  (also UnboundLocalError, by fuzzing)
            raise InvalidRecordError(
                f"{path}: no MAT file of level 5, or damaged ({said_by(error)}): save it again "
                "with '-v7'") from None


def _collect(columns: dict[str, np.ndarray], name: str, value: np.ndarray, path: Path) -> None:
    """Put a variable into the table, the fields of a structure one by one."""
    if value.dtype.names is not None:
        if value.size != 1:
            raise InvalidRecordError(f"{path}: {name} is an array of {value.size} structures, "
                                     "expected one: save its columns as arrays")
        for member in value.dtype.names:
            inner = value.ravel()[0][member]
            if isinstance(inner, np.ndarray) and inner.dtype.kind in "fiub" and inner.ndim <= 2:
                columns[f"{name}.{member}"] = inner.astype(np.float64)
        return
    columns[name] = real_array(value, f"{path}: {name}")


def read_npz(path: Path, needed: Sequence[str | int] | None) -> Table:
    """Return the arrays of an NPZ file that are needed, those named by number included.

    Raises
    ------
    InvalidRecordError
        Damaged, too large, or an array that is not of numbers.
    """
    columns: dict[str, np.ndarray] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            sizes = {entry.filename.removesuffix(".npy"): entry.file_size
                     for entry in archive.infolist() if entry.filename.endswith(".npy")}
            names = list(sizes)
            if needed is None:
                needed = names
            by_name = {part for name in needed if isinstance(name, str)
                       for part in (name, base_name(name))}
            by_number = {names[n] for n in needed if isinstance(n, int) and n < len(names)}
            wanted = (by_name | by_number) & set(names)
            total = sum(sizes[name] for name in wanted)
            if total > MAX_FILE_BYTES:
                raise InvalidRecordError(f"{path}: {total} bytes once unpacked, at most "
                                         f"{MAX_FILE_BYTES}: import a part of it")
        with np.load(path, allow_pickle=False) as loaded:
            for name in names:
                columns[name] = _array(loaded[name], f"{path}: {name}") if name in wanted else \
                    np.empty((0, 0))
    except DAMAGED as error:
        raise InvalidRecordError(
            f"{path}: no NPZ file, damaged, or with objects that would need pickle "
            f"({said_by(error)}): save arrays of numbers with numpy.savez") from None
    return Table(columns=columns, source=str(path))


def _array(value: np.ndarray, where: str) -> np.ndarray:
    numbers = real_array(value, where)
    if numbers.ndim:
        check_shape(max(numbers.shape), min(numbers.shape) if numbers.ndim == 2 else 1, where)
    return np.atleast_1d(numbers)


def read_parquet(path: Path, needed: Sequence[str | int] | None) -> Table:
    """Return the columns of a Parquet file that are needed, all where None.

    Raises
    ------
    UsageError
        pyarrow is not installed.
    InvalidRecordError
        Damaged, too large, or a column that is neither of numbers, times nor words.
    """
    pa = library("pyarrow", f"{path}: Parquet", "save the table as CSV", "export")
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            names = file.schema_arrow.names
            check_shape(file.metadata.num_rows, len(names), str(path))
            wanted = [names[k] for k in sorted(chosen(names, needed))]
            for name in wanted:
                if pa.types.is_nested(kind := file.schema_arrow.field(names.index(name)).type):
                    raise InvalidRecordError(f"{path}: {name} is {str(kind)[:40]}, expected "
                                             "numbers, times or words: name another column")
            words = [field.name for field in file.schema_arrow if pa.types.is_string(field.type)
                     or pa.types.is_large_string(field.type)]
        with pq.ParquetFile(  # a text once, not a row
                path, read_dictionary=words, page_checksum_verification=True) as file:
            total, parts = 0, []
            # By what comes: asked for the sizes of damaged metadata, pyarrow ends the process.
            for part in file.iter_batches(columns=wanted):
                total += part.nbytes
                if total > MAX_FILE_BYTES:
                    raise InvalidRecordError(f"{path}: more than {MAX_FILE_BYTES} bytes once "
                                             "unpacked: import a part of it")
                parts.append(part)
            read = pa.Table.from_batches(parts, None if parts else pa.schema(
                [file.schema_arrow.field(names.index(name)) for name in wanted]))
        columns: dict[str, Cells] = {}
        for name in names:
            if name in wanted:
                columns[name] = _column(read.column(name), f"{path}: {name}", pa)
            else:
                columns[name] = np.empty((0, 0))
        units = {field.name: field.metadata[b"unit"].decode("utf-8", "replace")
                 for field in read.schema if field.metadata and b"unit" in field.metadata}
        stamps = frozenset(f.name for f in read.schema if pa.types.is_temporal(f.type))
        units |= dict.fromkeys(stamps, SECONDS)
    except (pa.ArrowException, OSError) as error:
        raise InvalidRecordError(f"{path}: no Parquet file, or damaged ({said_by(error)}): save "
                                 "it again") from None
    return Table(columns=columns, source=str(path), units=units, stamps=stamps)


def _column(values: Any, where: str, pa: Any) -> Cells:
    """Return one column: numbers as float64 with NaN where null, times in seconds, or words."""
    kind, types = values.type, pa.types
    if types.is_timestamp(kind) or types.is_time(kind) or types.is_duration(kind):
        found = values.to_numpy()
        if found.dtype.kind not in "mM":
            raise InvalidRecordError(f"{where} is {kind}: save its time as seconds or as a "
                                     "timestamp")
        known = ~np.isnat(found)
        nanoseconds = found.astype(f"{found.dtype.kind}8[ns]").astype(np.int64)
        seconds = (nanoseconds - nanoseconds[known][:1].sum()) * 1e-9
        return np.where(known, seconds, np.nan)
    if types.is_dictionary(kind) and (
            types.is_string(kind.value_type) or types.is_large_string(kind.value_type)):
        cells = []
        for chunk in values.chunks:
            said = [text or "" for text in chunk.dictionary.to_pylist()]
            cells += ["" if k is None else said[k] for k in chunk.indices.to_pylist()]
        part = CellBlock.of(cells, range(1, len(cells) + 1), ".")
        return TextColumn((part,)) if part.values is None else part.values
    if not (types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)
            or types.is_decimal(kind)):
        raise InvalidRecordError(f"{where} is {str(kind)[:40]}, expected numbers, times or words: "
                                 "name another column")
    return np.array([float("nan") if v is None else float(v) for v in values.to_pylist()])
