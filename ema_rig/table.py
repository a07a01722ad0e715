"""Files of other tools as named columns, and the bounds of what is read."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ema_record.errors import InvalidRecordError, UsageError, unknown_name

MAX_FILE_BYTES = 1 << 30
"""Largest file (bytes), and largest content once unpacked."""
MAX_TEXT_BYTES = 512 << 20
"""Largest text, unpacked (bytes)."""
MAX_ROWS = 5_000_000
MAX_COLUMNS = 1000
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


def real_array(value: np.ndarray, where: str) -> np.ndarray:
    """Return an array of a file as float64; refuse what is no array or matrix of real numbers."""
    if value.dtype.kind not in "fiub" or value.ndim > 2:
        raise InvalidRecordError(f"{where} has {value.ndim} dimensions of {value.dtype}, "
                                 "expected one or two of real numbers")
    return value.astype(np.float64)
