"""Verdicts as tables: CSV, Parquet, DataFrame."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from io import StringIO
from pathlib import Path
from typing import Any

from ema_prognostics.fleet.verdict_store import in_utf8
from ema_record.errors import library

TEXT, NUMBER, INTEGER, TIME = "text", "number", "integer", "time"
COLUMNS = {
    "serial_number": TEXT, "time": TIME, "flight": INTEGER, "profile": TEXT, "bag": TEXT,
    "verdict": TEXT, "fault": INTEGER, "fault_class": TEXT, "phase": TEXT, "severity": NUMBER,
    "severity_lower": NUMBER, "severity_upper": NUMBER, "severity_unit": TEXT, "level": TEXT,
    "reasons": TEXT, "record_sha256": TEXT, "model_sha256": TEXT, "kit": TEXT,
    "kit_sha256": TEXT, "software_version": TEXT, "schema": TEXT,
}
"""Columns of the tables, with what they hold; ``fault`` counts the faults of a bag from 1."""
OURS = "ema fleet"
"""Names this software in the files that it may write anew."""


def rows_of(found: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a row a fault of a verdict's JSON object, one of a bag without any."""
    kit = found["kit"]
    bag = {name: found.get(name) for name in COLUMNS} | {
        "kit": kit["name"], "kit_sha256": kit["sha256"], "fault": None,
        "reasons": "; ".join(found["reasons"])}
    for number, fault in enumerate(found["faults"] or [{}], start=1):
        lower, upper = fault.get("severity_interval") or (None, None)
        own = {"fault": number, "severity_lower": lower, "severity_upper": upper} if fault else {}
        yield bag | {name: fault[name] for name in COLUMNS if name in fault} | own


def csv_text(found: Mapping[str, Any], *, header: bool) -> str:
    """Return the rows of an object as CSV (RFC 4180), with the header if asked."""
    text = StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    if header:
        writer.writeheader()
    writer.writerows(rows_of(found))
    return text.getvalue()


def write_parquet(objects: Iterable[Mapping[str, Any]], path: Path) -> None:
    """Write the rows of objects as Parquet, over `path`; times are timestamps (ms, UTC)."""
    pa = library("pyarrow", "Parquet", "use --format csv")
    from datetime import datetime

    import pyarrow.parquet as pq

    kinds = {TEXT: pa.string(), NUMBER: pa.float64(), INTEGER: pa.int64(),
             TIME: pa.timestamp("ms", tz="UTC")}
    rows = [row for found in objects for row in rows_of(found)]
    for row in rows:
        if row["time"] is not None:
            row["time"] = datetime.fromisoformat(row["time"].replace("Z", "+00:00"))
        for name, text in row.items():
            if isinstance(text, str):
                row[name] = in_utf8(text)
    schema = pa.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()],
                       metadata={"written_by": OURS})
    with path.open("wb") as file:  # pyarrow takes no name that is not UTF-8
        pq.write_table(pa.Table.from_pylist(rows, schema=schema), file)


def is_own_parquet(path: Path) -> bool:
    """Return whether a file is a table of `write_parquet`."""
    pa = library("pyarrow", "Parquet", "use --format csv")
    import pyarrow.parquet as pq

    try:
        if not path.is_file():  # a pipe would be waited for
            return False
        with path.open("rb") as file:
            metadata = pq.read_schema(file).metadata or {}
    except (OSError, pa.ArrowException):
        return False
    return bool(metadata.get(b"written_by") == OURS.encode())
