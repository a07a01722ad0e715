"""Verdicts as tables: CSV, Parquet, and the state of the units as OpenMetrics text."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ema_record.errors import library

if TYPE_CHECKING:
    from ema_prognostics.fleet.fleet import Fleet

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
    schema = pa.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()],
                       metadata={"written_by": OURS})
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), path)


def is_own_parquet(path: Path) -> bool:
    """Return whether a file is a table of `write_parquet`."""
    pa = library("pyarrow", "Parquet", "use --format csv")
    import pyarrow.parquet as pq

    try:
        metadata = pq.read_schema(path).metadata or {}
    except (OSError, pa.ArrowException):
        return False
    return bool(metadata.get(b"written_by") == OURS.encode())


def open_metrics(fleet: Fleet) -> str:
    """Return the state of the units as OpenMetrics 1.0 text, for a textfile collector.

    It holds gauges alone, so that readers of the older text format of Prometheus take it too.
    """
    from ema_prognostics.fleet.fleet import STATES, share_of_large

    units = [({"serial_number": u.serial_number or "unknown"}, u) for u in fleet.units]
    lines = [
        "# TYPE ema_unit_state gauge",
        f"# HELP ema_unit_state What the unit needs, written by {OURS}.",
        *(_sample("ema_unit_state", labels | {"ema_unit_state": state}, int(u.state == state))
          for labels, u in units for state in STATES),
        "# TYPE ema_unit_tests gauge", "# HELP ema_unit_tests Bags of the unit.",
        *(_sample("ema_unit_tests", labels, len(u.objects)) for labels, u in units),
        "# TYPE ema_unit_last_test_timestamp_seconds gauge",
        "# UNIT ema_unit_last_test_timestamp_seconds seconds",
        "# HELP ema_unit_last_test_timestamp_seconds Start of the last test.",
        *(_sample("ema_unit_last_test_timestamp_seconds", labels, u.last.start_time / 1e9)
          for labels, u in units if u.last.start_time),
        "# TYPE ema_fault_severity_ratio gauge", "# UNIT ema_fault_severity_ratio ratio",
        "# HELP ema_fault_severity_ratio Severity now, of that of a large fault.",
        *(_sample("ema_fault_severity_ratio", labels | {
            "fault_class": f.history.fault_class, "phase": f.history.phase or "",
            "confirmed": str(f.present).lower()}, share_of_large(f))
          for labels, u in units for f in u.trend.faults if f.episodes[-1].cleared is None),
    ]
    return "\n".join([*lines, "# EOF"]) + "\n"


def _sample(name: str, labels: Mapping[str, str], value: float) -> str:
    inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
    return f"{name}{{{inside}}} {value:.10g}"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
