"""CSV and other text as columns: encoding, header, units, delimiter and decimals found by looking.

Files of numbers alone are read by numpy; those with other cells row by row, the needed columns
only, and a cell that is no number is an error only where its column is asked for.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import itertools
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ema_record.errors import InvalidRecordError
from ema_rig.map import TextFormat
from ema_rig.table import (
    MAX_TEXT_BYTES,
    MISSING,
    CellBlock,
    Cells,
    Table,
    TextColumn,
    check_shape,
    chosen,
)
from ema_rig.units import is_unit

_COMMENT = ("#", "%", "//", "!")
_DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": None}
_NUMBER = re.compile(
    r"^[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?$|^[+-]?(nan|inf)$", re.IGNORECASE
)
_TIME = re.compile(r"^\d{4}-\d\d?-\d\d?([T ]|$)|^\d+:\d\d(:\d\d)?([.,]\d+)?$|^\d+[./]\d+[./]\d+ ")
_COMMA, _POINT = re.compile(r"\d,\d"), re.compile(r"\d\.\d")
_LOOK = 64 << 10
_ROWS = 50_000
"""Rows that are converted at a time."""
_ALIKE = 8
"""Rows below the first that must look like it."""


@dataclass(frozen=True, kw_only=True)
class _Layout:
    """How the text is laid out."""

    first: int
    """Line of the first row, from 0."""
    names: tuple[str, ...]
    units: tuple[str, ...]
    """Of the row of units, empty without one."""
    delimiter: str | None
    decimal: str
    notes: tuple[str, ...]


def read_text_table(
    path: Path, text_format: TextFormat, needed: Sequence[str | int] | None
) -> Table:
    """Return the columns of a text file, which may be compressed by gzip.

    Parameters
    ----------
    path : in UTF-8, UTF-16 or Latin-1.
    text_format : how it is laid out, where that is known.
    needed : columns that are wanted, all where None.

    Raises
    ------
    InvalidRecordError
        Too large, not text, or a row has another number of cells than the first.
    """
    return table_of_text(_decoded(_content(path), path), path, text_format, needed)


def table_of_text(
    text: str, path: Path, text_format: TextFormat, needed: Sequence[str | int] | None
) -> Table:
    """Return the columns of a text, as `read_text_table`; `path` is for errors."""
    lines = text.split("\n", text_format.skip + 2000)
    try:
        layout = _layout(lines, _with_decimal(text_format, lines), path)
    except csv.Error as error:  # a cell of more than 128 KiB
        raise InvalidRecordError(f"{path}: {error}: correct that cell, or leave its column out"
                                 ) from None
    count = len(layout.names)
    check_shape(text.count("\n") + 1 - layout.first, count, str(path))
    body = text.split("\n", layout.first)[-1]
    values = None if '"' in body[:_LOOK] else _all_numbers(body, layout)
    if values is not None and values.shape[1] == count:
        columns: dict[str, Cells] = {label: values[:, k] for k, label in enumerate(layout.names)}
        notes = layout.notes
    else:
        wanted = chosen(layout.names, needed)
        found, more = _rows(body, layout, sorted(wanted), path)
        empty = np.empty((0, 0))
        columns = {label: found.get(k, empty) for k, label in enumerate(layout.names)}
        notes = (*layout.notes, *more)
    units = {name: unit for name, unit in zip(layout.names, layout.units) if unit}
    return Table(columns=columns, source=str(path), notes=notes, units=units)


def holds_numbers(text: str, text_format: TextFormat) -> bool:
    """Return whether a text has a row of numbers, by its first lines."""
    try:
        _layout(text.split("\n", text_format.skip + 2000), text_format, Path())
    except (InvalidRecordError, csv.Error):
        return False
    return True


def _with_decimal(text_format: TextFormat, lines: list[str]) -> TextFormat:
    """Return the format with its decimal mark: a comma where a delimiter leaves it free."""
    if text_format.decimal is not None:
        return text_format
    last = "\n".join([line for line in lines[:-1] or lines if line.strip()][-20:])
    split = text_format.delimiter in ("semicolon", "tab", "space") or (
        text_format.delimiter is None and (";" in last or "\t" in last))
    quoted = [cell for cell in re.findall(r'"([^"]*)"', last) if _NUMBER.match(cell)]
    comma = not _POINT.search(last) and (
        (split and _COMMA.search(last)) or any("," in cell for cell in quoted))
    return text_format.model_copy(update={"decimal": "," if comma else "."})


def _content(path: Path) -> bytes:
    """Return the bytes of the file, unpacked within the bound."""
    with path.open("rb") as stream:
        packed = stream.read(2) == b"\x1f\x8b"
        stream.seek(0)
        try:
            source = gzip.GzipFile(fileobj=stream) if packed else stream
            data = source.read(MAX_TEXT_BYTES + 1)
        except (OSError, EOFError, zlib.error) as error:
            raise InvalidRecordError(
                f"{path}: damaged gzip ({str(error)[:60]}): copy the file again") from None
    if len(data) > MAX_TEXT_BYTES:
        raise InvalidRecordError(f"{path}: more than {MAX_TEXT_BYTES} bytes of text: import a "
                                 "part of it, or save it as NPZ")
    return data


def _decoded(data: bytes, path: Path) -> str:
    """Return the text: UTF-16 by its mark or by the zeros between, else UTF-8 or Latin-1."""
    encoding = "utf-8-sig"
    zeros = [data[k:_LOOK:2].count(0) for k in (0, 1)]
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        encoding = "utf-16"
    elif max(zeros) > 0.3 * min(len(data), _LOOK) / 2 and min(zeros) == 0:
        encoding = "utf-16-be" if zeros[0] else "utf-16-le"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if "\x00" in text[:_LOOK]:
        raise InvalidRecordError(f"{path}: not text (zero bytes in it): save it as CSV, or give "
                                 "the file its right suffix")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _layout(lines: list[str], text_format: TextFormat, path: Path) -> _Layout:
    """Return where the rows begin, the names and units above them, and how cells are divided."""
    above: list[str] = []
    left = 0
    for index, line in enumerate(lines[text_format.skip:], start=text_format.skip):
        stripped = line.strip()
        if not stripped:
            continue
        delimiter = _delimiter(stripped, text_format)
        cells = _cells(stripped, delimiter)
        if _begins(cells, lines[index + 1:index + 1 + 3 * _ALIKE], delimiter):
            rows = [[cell.strip().strip("\"'") for cell in _cells(line, delimiter)]
                    for line in above[-2:]]
            header = rows[-1] if rows else []
            if text_format.header and not header:
                raise InvalidRecordError(f"{path}: line {index + 1} holds numbers, expected "
                                         "names: set format.header: false in the map")
            units: list[str] = []
            if len(rows) == 2 and len(rows[0]) == len(header) and _is_units(header):
                header, units = rows[0], [cell.strip(" []()") for cell in header]
            common = min(len(header) or len(cells), len(cells))
            if not "".join([*header[common:], *cells[common:]]).strip():  # delimiters at the end
                header, cells = header[:common], cells[:common]
            if text_format.header is False or len(header) != len(cells):
                header, units = [str(number) for number in range(len(cells))], []
            names = [name if header.index(name) == k else f"{name}#{k}"
                     for k, name in enumerate(header)]
            return _Layout(
                first=index, names=tuple(names), units=tuple(units), delimiter=delimiter,
                decimal=text_format.decimal or ".",
                notes=(f"{left} lines before the numbers",) if left > 1 else ())
        left += 1
        bare = stripped
        for mark in _COMMENT:
            bare = bare.removeprefix(mark)
        bare = bare.strip()
        if not stripped.startswith(_COMMENT) or len(_cells(bare, _delimiter(
                bare, text_format))) > 1:
            above.append(bare)
    raise InvalidRecordError(
        f"{path}: no row of numbers in its first {len(lines)} lines: set format.skip, "
        "format.delimiter or format.decimal in the map"
    )


def _kinds(cells: list[str]) -> str:
    """Return a letter a cell: n a number, t a date or time, e empty, x other text."""
    bare = [cell.strip() for cell in cells]
    return "".join("n" if _NUMBER.match(c) else "t" if _TIME.match(c) else
                   "e" if c.lower() in MISSING else "x" for c in bare)


def _begins(cells: list[str], below: list[str], delimiter: str | None) -> bool:
    """Return whether the rows begin here: numbers, and the same kinds of cells below."""
    own = _kinds(cells)
    if set(own) <= {"n", "e"} and "n" in own:
        return True
    if "n" not in own or (len(own) > 1 and own.count("n") + own.count("t") < 2):
        return False
    others = [_kinds(_cells(line.strip(), delimiter)) for line in below if line.strip()][:_ALIKE]
    alike = [other for other in others if len(other) == len(own)]
    return len(alike) >= 0.7 * len(others) - 1.0 and all(
        sum(other[k] in (kind, "e") for other in alike) >= 0.7 * len(alike)
        for k, kind in enumerate(own) if kind in "nt")


def _is_units(cells: list[str]) -> bool:
    """Return whether a row holds units, as ``[ms];[N m];-``; some words may be unknown."""
    bare = [cell.strip(" []()") for cell in cells]
    known = [not cell or cell in ("-", "1") or is_unit(cell) for cell in bare]
    return any(cell and is_unit(cell) for cell in bare) and sum(known) >= 0.5 * len(known)


def _delimiter(line: str, text_format: TextFormat) -> str | None:
    """Return the delimiter, None for any white space."""
    if text_format.delimiter is not None:
        return _DELIMITERS[text_format.delimiter]
    bare = re.sub(r'"[^"]*"', "", line)
    quoted = text_format.decimal == "," and bare != line and ";" not in bare and "\t" not in bare
    candidates = [";", "\t"] if text_format.decimal == "," and not quoted else [",", ";", "\t"]
    return next((mark for mark in candidates if mark in bare), None)


def _cells(line: str, delimiter: str | None) -> list[str]:
    if '"' not in line:
        return line.strip("\r\n").split(delimiter)
    return next(csv.reader([line], delimiter=delimiter or " ", skipinitialspace=True), [])


def _all_numbers(body: str, layout: _Layout) -> np.ndarray | None:
    """Return all rows where all cells are numbers or empty, shape (n, columns), else None."""
    delimiter = layout.delimiter
    if layout.decimal == ",":
        body = body.replace(",", ".")
    if delimiter is not None and any(
            mark in body for mark in (2 * delimiter, delimiter + "\n", "\n" + delimiter)):
        body = "\n".join(_filled(line, delimiter) for line in body.split("\n"))
    try:
        return np.loadtxt(io.StringIO(body), delimiter=delimiter, ndmin=2, comments=_COMMENT)
    except ValueError:
        return None


def _filled(line: str, delimiter: str) -> str:
    """Return a row with NaN in its empty cells."""
    if not line.strip():
        return ""
    return delimiter.join(cell.strip() or "nan" for cell in line.split(delimiter))


def _rows(
    body: str, layout: _Layout, wanted: list[int], path: Path
) -> tuple[dict[int, Cells], tuple[str, ...]]:
    """Return the wanted columns of rows of any cells, and what was left out."""
    reader = _numbered(body, layout, path)
    count = len(layout.names)
    parts: dict[int, list[CellBlock]] = {k: [] for k in wanted}
    short: tuple[int, int] | None = None
    total = 0
    while True:
        rows: list[list[str]] = []
        lines: list[int] = []
        for line, cells in itertools.islice(reader, _ROWS):
            if short is not None:
                raise _uneven(path, *short, count)
            while len(cells) > count and not cells[-1].strip():
                cells.pop()
            if len(cells) == count:
                rows.append(cells)
                lines.append(line)
            else:
                short = line, len(cells)
        if not lines:
            break
        total += len(lines)
        for k in wanted:
            parts[k].append(CellBlock.of([row[k].strip() for row in rows], lines, layout.decimal))
    if short is not None and (short[1] > count or not total):
        raise _uneven(path, *short, count)
    columns: dict[int, Cells] = {}
    for k in wanted:
        text = TextColumn(tuple(parts[k]))
        words = any(part.values is None for part in text.parts)
        columns[k] = text if words else text.numbers(str(path), layout.names[k])
    return columns, () if short is None else (f"line {short[0]} is cut and left out",)


def _numbered(body: str, layout: _Layout, path: Path) -> Iterator[tuple[int, list[str]]]:
    """Return the number of the line and the cells of each row."""
    stream = io.StringIO(body, newline="")
    if layout.delimiter is None and '"' not in body:
        for number, line in enumerate(stream):
            if line.strip() and not line.lstrip().startswith(_COMMENT):
                yield layout.first + 1 + number, line.split()
        return
    reader = csv.reader(stream, delimiter=layout.delimiter or " ", skipinitialspace=True)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells) and not cells[0].startswith(_COMMENT):
                yield layout.first + reader.line_num, cells
    except csv.Error as error:
        at = layout.first + reader.line_num
        raise InvalidRecordError(f"{path}: line {at}: {error}: correct that line") from None


def _uneven(path: Path, line: int, found: int, count: int) -> InvalidRecordError:
    return InvalidRecordError(
        f"{path}: line {line}: {found} columns, expected {count} as above it: correct that line, "
        "or set format.delimiter, format.decimal or format.skip in the map")
