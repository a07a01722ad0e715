"""Files of other tools as named columns: the bounds, and which reader takes which file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ema_record.errors import InvalidRecordError, UsageError, unknown_name
from ema_rig.map import TextFormat

MAX_FILE_BYTES = 1 << 30
"""Largest file (bytes), and largest content once unpacked."""
MAX_TEXT_BYTES = 512 << 20
"""Largest text, unpacked (bytes)."""
MAX_ROWS = 5_000_000
MAX_COLUMNS = 1000
SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".mat", ".npz", ".gz")
_INDEXED = re.compile(r"^(.*)\[(\d{1,4})\]$")


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Columns of a file by name, all of them float64 with one dimension or two."""

    columns: Mapping[str, np.ndarray]
    source: str
    notes: tuple[str, ...] = field(default=())

    def column(self, name: str | int, where: str) -> np.ndarray:
        """Return one column, shape (n,); `where` is the key of the map that asks for it.

        Raises
        ------
        UsageError
            No such column, or not a column.

        """
        names = list(self.columns)
        if isinstance(name, int):
            if name >= len(names):
                raise UsageError(
                    f"{self.source}: {where}: no column {name}: the file has {len(names)}, "
                    f"numbered from 0 ({_listed(names)})"
                )
            name = names[name]
        matched = _INDEXED.match(name)
        index = None
        if name not in self.columns and matched:
            name, index = matched[1], int(matched[2])
        if name not in self.columns:
            raise unknown_name("column", name, names, f"{self.source}: {where}: the file has "
                               f"{_listed(names)}")
        values = self.columns[name]
        if index is not None:
            if values.ndim != 2 or index >= values.shape[1]:
                raise UsageError(
                    f"{self.source}: {where}: {name} has shape {values.shape}, so no column "
                    f"{index}: columns are numbered from 0"
                )
            return values[:, index]
        if values.ndim == 2 and 1 in values.shape:
            return values.ravel()
        if values.ndim != 1:
            raise UsageError(
                f"{self.source}: {where}: {name} has shape {values.shape}, expected one column: "
                f"name one as {name}[0]"
            )
        return values

    def scalar(self, name: str, where: str) -> float:
        """Return a single number of the file."""
        values = self.column(name, where)
        if values.size != 1 or not np.isfinite(values).all():
            raise UsageError(
                f"{self.source}: {where}: {name} holds {values.size} values, expected one finite "
                "number: write the number itself into the map"
            )
        return float(values[0])


def _listed(names: Sequence[str]) -> str:
    return ", ".join(name[:30] for name in names[:12]) + (" ..." if len(names) > 12 else "")


def read_table(path: Path, text_format: TextFormat, needed: Sequence[str | int]) -> Table:
    """Return the columns of a CSV, TXT, MAT (v5) or NPZ file.

    Parameters
    ----------
    path : Path
        Known by its suffix; text may be compressed by gzip.
    text_format : TextFormat
        How text is laid out, where that is known.
    needed : sequence of str or int
        Columns that are wanted; a MAT or NPZ file is read no further.

    Raises
    ------
    InvalidRecordError
        Damaged, too large, or of a kind that cannot be read safely.
    UsageError
        Not one of these kinds, or not there.

    """
    if not path.is_file():
        raise UsageError(f"{path}: no such file: give a CSV, TXT, MAT or NPZ file")
    size = path.stat().st_size
    if not 0 < size <= MAX_FILE_BYTES:
        raise InvalidRecordError(f"{path}: {size} bytes, expected 1 to {MAX_FILE_BYTES}: "
                                 "import a part of it")
    suffix = path.suffix.lower()
    if suffix == ".mat":
        from ema_rig.mat import read_mat

        return read_mat(path, needed)
    if suffix == ".npz":
        from ema_rig.npz import read_npz

        return read_npz(path, needed)
    if suffix not in SUFFIXES:
        raise UsageError(f"{path}: a file {suffix or 'without suffix'!r} is not known: give one "
                         f"of {', '.join(SUFFIXES)}")
    from ema_rig.text import read_text_table

    return read_text_table(path, text_format)


def check_shape(rows: int, columns: int, source: str) -> None:
    """Refuse more rows or columns than are read."""
    if rows > MAX_ROWS or columns > MAX_COLUMNS:
        raise InvalidRecordError(
            f"{source}: {rows} rows and {columns} columns, at most {MAX_ROWS} and {MAX_COLUMNS}: "
            "import a part of it"
        )


def base_name(name: str) -> str:
    """Return the variable that a column of a map belongs to: ``data`` of ``data.q[2]``."""
    matched = _INDEXED.match(name)
    return (matched[1] if matched else name).split(".")[0]
