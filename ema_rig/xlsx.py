"""Sheets of a workbook (XLSX): laid out as text, they are read as any text is.

A row of the sheet is a line, so that a cell that is no number is named by its row.
"""

from __future__ import annotations

import csv
import datetime as dt
import io
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ema_record.errors import InvalidRecordError, RecordError, UsageError, library, unknown_name
from ema_rig.map import TextFormat
from ema_rig.table import MAX_COLUMNS, MAX_TEXT_BYTES, Table, check_shape, said_by
from ema_rig.text import holds_numbers, table_of_text

MAX_CELL, MAX_SHEETS = 32_767, 20
"""Characters of a cell, as of a spreadsheet; and sheets that are looked at."""


def read_xlsx(path: Path, text_format: TextFormat, needed: Sequence[str | int] | None) -> Table:
    """Return the columns of a sheet: ``format.sheet`` of the map, or the first with numbers.

    Raises
    ------
    UsageError
        openpyxl is not installed; no such sheet.
    InvalidRecordError
        Damaged, too large, or no row of numbers.
    """
    openpyxl = library("openpyxl", f"{path}: XLSX", "save the sheet as CSV", "export")
    layout = text_format.model_copy(update={"delimiter": "comma", "decimal": "."})
    try:
        with zipfile.ZipFile(path) as archive:
            total = sum(entry.file_size for entry in archive.infolist())
        if total > MAX_TEXT_BYTES:
            raise InvalidRecordError(f"{path}: {total} bytes once unpacked, at most "
                                     f"{MAX_TEXT_BYTES}: import a part of it")
        book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
        try:
            names = [sheet.title for sheet in book.worksheets]
            if text_format.sheet is not None and text_format.sheet not in names:
                raise unknown_name("sheet", text_format.sheet, names, f"{path}: the workbook has "
                                   f"{', '.join(names[:12]) or 'none'}")
            name, text = _chosen(book, names, layout, str(path))
        finally:
            book.close()
    except (RecordError, UsageError):
        raise
    except Exception as error:  # noqa: BLE001  (whatever openpyxl trips over in a damaged file)
        raise InvalidRecordError(f"{path}: no XLSX file, or damaged ({said_by(error)}): save it "
                                 "again, or as CSV") from None
    found = table_of_text(text, path, layout, needed)
    if len(names) == 1:
        return found
    return replace(found, notes=(f"sheet {name!r} of {len(names)}", *found.notes))


def _chosen(book: Any, names: Sequence[str], layout: TextFormat, source: str) -> tuple[str, str]:
    """Return the name and the text of the sheet that the map names, or the first with numbers."""
    if layout.sheet is not None:
        return layout.sheet, _text(book[layout.sheet], source)
    first = "", ""
    for name in names[:MAX_SHEETS]:
        text = _text(book[name], source)
        if holds_numbers(text, layout):
            return name, text
        first = first if first[0] else (name, text)
    return first


def _text(sheet: Any, source: str) -> str:
    """Return the rows of a sheet as lines, empty ones too, within the bounds of a text."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    last = 0
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        cells = [_cell(value) for value in row[:MAX_COLUMNS + 1]]
        while cells and not cells[-1]:
            cells.pop()
        check_shape(number, len(cells), source)
        if stream.tell() > MAX_TEXT_BYTES:
            raise InvalidRecordError(f"{source}: more than {MAX_TEXT_BYTES} bytes of cells: "
                                     "import a part of it")
        if cells:
            stream.write("\n" * (number - last - 1))
            writer.writerow(cells)
            last = number
    return stream.getvalue()


def _cell(value: Any) -> str:
    """Return a cell as a text file has it."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, dt.datetime):
        return value.isoformat(sep="T")
    if isinstance(value, dt.timedelta):
        total = value.total_seconds()
        return f"{int(total // 3600)}:{int(total // 60 % 60):02d}:{total % 60:09.6f}"
    if isinstance(value, dt.time):
        return value.isoformat()
    return " ".join(str(value)[:MAX_CELL].split())
