"""Files of other tools as named columns, and the bounds of what is read."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
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

MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "--"})
"""Cells that lack a value, in lower case."""


@dataclass(frozen=True, slots=True)
class CellBlock:
    """Some rows of one column of a text: numbers where all cells are, else the cells."""

    values: np.ndarray | None
    cells: tuple[str, ...]
    lines: tuple[int, ...]
    """Of the cells in the file, from 1; empty beside numbers."""
    decimal: str

    @classmethod
    def of(cls, cells: Sequence[str], lines: Sequence[int], decimal: str) -> CellBlock:
        """Return cells as numbers if they all are."""
        try:
            values = np.array([_number(cell, decimal) for cell in cells])
        except ValueError:
            return cls(None, tuple(cells), tuple(lines), decimal)
        return cls(values, (), (), decimal)


def _number(cell: str, decimal: str) -> float:
    if cell.lower() in MISSING:
        return float("nan")
    if "_" in cell:
        raise ValueError
    return float(cell.replace(",", ".") if decimal == "," else cell)


@dataclass(frozen=True, slots=True)
class TextColumn:
    """A column of a text file that is not of numbers alone."""

    parts: tuple[CellBlock, ...]

    def numbers(self, source: str, name: str) -> np.ndarray:
        """Return the column as numbers, shape (n,); the first cell that is none is named."""
        for part in self.parts:
            for line, cell in zip(part.lines, part.cells):
                try:
                    _number(cell, part.decimal)
                except ValueError:
                    raise InvalidRecordError(
                        f"{source}: line {line}, column {name!r}: {cell[:40]!r} is not a number: "
                        "correct that cell, or name another column in the map") from None
        return np.concatenate([part.values for part in self.parts if part.values is not None]
                              or [np.empty(0)])

    def words(self) -> Iterator[tuple[int, str]]:
        """Return the line and the text of each cell; 0 where the line is not known."""
        for part in self.parts:
            if part.values is None:
                yield from zip(part.lines, part.cells)
            else:
                yield from ((0, "" if np.isnan(value) else f"{value:.15g}")
                            for value in part.values)


Cells = np.ndarray | TextColumn


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Columns of a file by name: float64 with one dimension or two, or text."""

    columns: Mapping[str, Cells]
    source: str
    notes: tuple[str, ...] = field(default=())
    units: Mapping[str, str] = field(default_factory=dict)
    """Units of columns as the file gives them, in its own words."""
    times: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Of columns that have a clock of their own (s)."""
    stamps: frozenset[str] = frozenset()
    """Columns that are times by their type in the file; their unit, there, is known: read in s."""

    def name_of(self, name: str | int, where: str) -> str:
        """Return the name of a column that a map gives by name or number."""
        if not isinstance(name, int):
            return name
        names = list(self.columns)
        if name >= len(names):
            raise UsageError(
                f"{self.source}: {where}: no column {name}: the file has {len(names)}, "
                f"numbered from 0 ({_listed(names)})"
            )
        return names[name]

    def text(self, name: str | int, where: str) -> TextColumn | None:
        """Return a column that is text, None where it is of numbers."""
        found = self.columns.get(self.name_of(name, where))
        return found if isinstance(found, TextColumn) else None

    def column(self, name: str | int, where: str) -> np.ndarray:
        """Return one column, shape (n,); `where` is the key of the map that asks for it.

        Raises
        ------
        UsageError
            No such column, or not a column.
        """
        names = list(self.columns)
        numbered = isinstance(name, int)
        name = self.name_of(name, where)
        matched = _INDEXED.match(name)
        index = None
        if name not in self.columns and matched:
            name, index = matched[1], int(matched[2])
        if name not in self.columns:
            raise unknown_name("column", name, names, f"{self.source}: {where}: the file has "
                               f"{_listed(names)}")
        again = [k for k, other in enumerate(names) if other == f"{name}#{k}"]
        if again and not numbered:
            raise UsageError(f"{self.source}: {where}: {name!r} is columns "
                             f"{', '.join(map(str, [names.index(name), *again]))}: give the "
                             "number of the one that is meant, from 0")
        values = self.columns[name]
        if isinstance(values, TextColumn):
            return values.numbers(self.source, name)
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


def chosen(names: Sequence[str], needed: Sequence[str | int] | None) -> set[int]:
    """Return the numbers of the columns that are wanted; all where `needed` is None."""
    if needed is None:
        return set(range(len(names)))
    return {names.index(n) for n in needed if isinstance(n, str) and n in names} | {
        n for n in needed if isinstance(n, int) and n < len(names)}


def _listed(names: Sequence[str]) -> str:
    return ", ".join(name[:30] for name in names[:12]) + (" ..." if len(names) > 12 else "")


def check_shape(rows: int, columns: int, source: str) -> None:
    """Refuse more rows or columns than are read."""
    if rows > MAX_ROWS or columns > MAX_COLUMNS:
        raise InvalidRecordError(
            f"{source}: {rows} rows and {columns} columns, at most {MAX_ROWS} and {MAX_COLUMNS}: "
            "import a part of it"
        )


def said_by(error: Exception) -> str:
    """Return what an error of another library says, on one short line."""
    return " ".join(str(error).split())[:80]


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
