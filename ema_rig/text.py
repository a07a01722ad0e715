"""CSV and other text as columns: comments, header, delimiter and decimals found by looking."""

from __future__ import annotations

import gzip
import io
import re
import zlib
from pathlib import Path

import numpy as np

from ema_record.errors import InvalidRecordError
from ema_rig.map import TextFormat
from ema_rig.table import MAX_TEXT_BYTES, Table, check_shape
from ema_rig.units import is_unit

_COMMENT = ("#", "%", "//", "!")
_DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": None}
_NUMBER = re.compile(
    r"^[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?$|^[+-]?(nan|inf)$", re.IGNORECASE
)
_COMMA, _POINT = re.compile(r"\d,\d"), re.compile(r"\d\.\d")
_LOOK = 64 << 10


def read_text_table(path: Path, text_format: TextFormat) -> Table:
    """Return the columns of a text file, which may be compressed by gzip.

    Raises
    ------
    InvalidRecordError
        Too large, not text, or a line does not hold the numbers of the first one.

    """
    data = _content(path)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
        if "\x00" in text[:_LOOK]:
            raise InvalidRecordError(
                f"{path}: not text (or text in UTF-16): save it as UTF-8") from None
    lines = text.split("\n", text_format.skip + 2000)
    text_format = _with_decimal(text_format, lines)
    first, names, notes = _beginning(lines, text_format, path)
    delimiter = _delimiter(lines[first], text_format)
    count = len(_cells(lines[first], delimiter))
    rows = text.count("\n") + 1 - first
    check_shape(rows, count, str(path))
    values = _numbers(text, first, delimiter, text_format.decimal or ".", path)
    labels = names or [str(number) for number in range(count)]
    if len(set(labels)) != len(labels):
        labels = [f"{label}#{k}" if labels.index(label) != k else label
                  for k, label in enumerate(labels)]
    return Table(columns={label: values[:, k] for k, label in enumerate(labels)},
                 source=str(path), notes=tuple(notes))


def _with_decimal(text_format: TextFormat, lines: list[str]) -> TextFormat:
    """Return the format with its decimal mark: a comma where a delimiter leaves it free."""
    if text_format.decimal is not None:
        return text_format
    last = next((line for line in reversed(lines[:-1] or lines) if line.strip()), "")
    split = text_format.delimiter in ("semicolon", "tab", "space") or (
        text_format.delimiter is None and (";" in last or "\t" in last))
    comma = split and _COMMA.search(last) and not _POINT.search(last)
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


def _beginning(
    lines: list[str], text_format: TextFormat, path: Path
) -> tuple[int, list[str], list[str]]:
    """Return the index of the first row of numbers, the names above it, and what was left out."""
    header: list[str] = []
    above: list[str] = []
    left = 0
    for index, line in enumerate(lines[text_format.skip:], start=text_format.skip):
        stripped = line.strip()
        if not stripped:
            continue
        cells = _cells(stripped, _delimiter(stripped, text_format))
        if len(cells) > 0 and all(_NUMBER.match(cell.strip()) or not cell.strip()
                                  for cell in cells) and any(cell.strip() for cell in cells):
            if text_format.header and not header:
                raise InvalidRecordError(f"{path}: line {index + 1} holds numbers, expected "
                                         "names: set format.header: false in the map")
            if _is_units(header) and len(above) == len(header):
                header = above
            if text_format.header is False or len(header) != len(cells):
                header = []  # a title or a remark, no names
            return index, header, [f"{left} lines before the numbers"] if left > 1 else []
        left += 1
        bare = stripped
        for mark in _COMMENT:
            bare = bare.removeprefix(mark)
        found = [cell.strip().strip("\"'") for cell in
                 _cells(bare.strip(), _delimiter(bare.strip(), text_format))]
        if not stripped.startswith(_COMMENT) or len(found) > 1:
            header, above = found, header
    raise InvalidRecordError(
        f"{path}: no row of numbers in its first {len(lines)} lines: set format.skip, "
        "format.delimiter or format.decimal in the map"
    )


def _is_units(cells: list[str]) -> bool:
    """Return whether a row holds units only, as ``[ms];[N m];-``."""
    bare = [cell.strip(" []()") for cell in cells]
    return any(bare) and all(
        not cell or cell in ("-", "1") or is_unit(cell) for cell in bare)


def _delimiter(line: str, text_format: TextFormat) -> str | None:
    """Return the delimiter, None for any white space."""
    if text_format.delimiter is not None:
        return _DELIMITERS[text_format.delimiter]
    candidates = [";", "\t"] if text_format.decimal == "," else [",", ";", "\t"]
    return next((mark for mark in candidates if mark in line), None)


def _cells(line: str, delimiter: str | None) -> list[str]:
    return line.strip("\r\n").split(delimiter)


def _numbers(
    text: str, first: int, delimiter: str | None, decimal: str, path: Path
) -> np.ndarray:
    """Return all rows of numbers, shape (n, columns); an empty cell is NaN."""
    body = text.split("\n", first)[-1]
    if decimal == ",":
        body = body.replace(",", ".")
    if delimiter is not None and any(
        mark in body
        for mark in (2 * delimiter, delimiter + "\n", delimiter + "\r", "\n" + delimiter)
    ):
        body = "\n".join(_filled(line, delimiter) for line in body.split("\n"))
    try:
        return np.loadtxt(io.StringIO(body), delimiter=delimiter, ndmin=2, comments=_COMMENT)
    except ValueError as error:
        detail = str(error).split(";")[0][:120]
        raise InvalidRecordError(
            f"{path}: {detail} (rows counted from line {first + 1}): correct that line, or set "
            "format.delimiter, format.decimal or format.skip in the map"
        ) from None


def _filled(line: str, delimiter: str) -> str:
    """Return a row with NaN in its empty cells."""
    if not line.strip():
        return ""
    return delimiter.join(cell.strip() or "nan" for cell in _cells(line, delimiter))
