"""Parquet files as columns, where pyarrow is installed; times count from the first of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ema_record.errors import InvalidRecordError, UsageError
from ema_rig.table import CellBlock, Cells, Table, TextColumn, check_shape, chosen


def read_parquet(path: Path, needed: Sequence[str | int] | None) -> Table:
    """Return the columns of a Parquet file that are needed, all where None.

    Raises
    ------
    UsageError
        pyarrow is not installed.
    InvalidRecordError
        Damaged, too large, or a column that is neither of numbers, times nor words.

    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise UsageError(f"{path}: Parquet needs the package pyarrow, which is not installed: pip "
                         "install 'ema_phm[export]', or save the table as CSV") from None
    try:
        with pq.ParquetFile(path) as file:
            names = file.schema_arrow.names
            check_shape(file.metadata.num_rows, len(names), str(path))
            wanted = [names[k] for k in sorted(chosen(names, needed))]
            read = file.read(columns=wanted)
        columns: dict[str, Cells] = {}
        for name in names:
            if name in wanted:
                columns[name] = _column(read.column(name), f"{path}: {name}", pa)
            else:
                columns[name] = np.empty((0, 0))
        units = {field.name: field.metadata[b"unit"].decode("utf-8", "replace")
                 for field in read.schema if field.metadata and b"unit" in field.metadata}
    except (pa.ArrowException, OSError) as error:
        text = " ".join(str(error).split())[:80]
        raise InvalidRecordError(f"{path}: no Parquet file, or damaged ({text}): save it "
                                 "again") from None
    return Table(columns=columns, source=str(path), units=units)


def _column(values: object, where: str, pa: object) -> Cells:
    """Return one column: numbers as float64 with NaN where null, times in seconds, or words."""
    kind = values.type  # type: ignore[attr-defined]
    types = pa.types  # type: ignore[attr-defined]
    if types.is_timestamp(kind) or types.is_time(kind) or types.is_duration(kind):
        found = values.to_numpy()  # type: ignore[attr-defined]
        if found.dtype.kind not in "mM":
            raise InvalidRecordError(f"{where} is {kind}: save its time as seconds or as a "
                                     "timestamp")
        nanoseconds = found.astype(f"{found.dtype.kind}8[ns]").astype(np.int64)
        return np.asarray((nanoseconds - nanoseconds[:1]) * 1e-9, dtype=np.float64)
    if types.is_string(kind) or types.is_large_string(kind):
        cells = [text or "" for text in values.to_pylist()]  # type: ignore[attr-defined]
        part = CellBlock.of(cells, range(1, len(cells) + 1), ".")
        return TextColumn((part,)) if part.values is None else part.values
    if not (types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)
            or types.is_decimal(kind)):
        raise InvalidRecordError(f"{where} is {str(kind)[:40]}, expected numbers, times or words: "
                                 "name another column")
    return np.array([float("nan") if v is None else float(v)
                     for v in values.to_pylist()])  # type: ignore[attr-defined]
