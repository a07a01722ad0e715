"""What a test report holds, as plain values: the content of its page, its XML and its JSON.

The words of outcomes are those of IEEE Std 1636.1 (test results): Passed, Failed, Inconclusive,
Aborted; a value has its unit and its limit. No conformance is claimed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from ema_prognostics.verdict.contract import kit_files
from ema_record.actuator_type import actuator_hash
from ema_record.bag.content_hash import bag_files, file_sha256
from ema_record.checks.live import CheckResult, Level
from ema_record.record import Record
from ema_record.sources import OURS, ROOT
from ema_record.version import VERSION

FORMAT, FORM = "ema_phm test report", 1
OUTCOMES = {"healthy": "Passed", "fault": "Failed", "unknown": "Inconclusive",
            "incomplete": "Aborted", "invalid": "Inconclusive"}
CHECK_OUTCOMES = {Level.OK: "Passed", Level.WARN: "Inconclusive", Level.ERROR: "Failed"}
FIELDS = ("ata", "aircraft", "work_order", "operator")
"""What the person who files the report may give; empty: a line to write on."""
UNITS = {"s": "s", "A": "A", "rad": "rad", "V": "V"}
"""Ends of the names of a check's values that are units."""


def report_data(
    verdict: Mapping[str, Any], record: Record, checks: Sequence[CheckResult], *,
    heading: Mapping[str, Any], fields: Mapping[str, str], trend: Iterable[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Return the content of a report.

    Parameters
    ----------
    verdict : of `Verdict.to_dict`.
    record : that was judged.
    checks : of the record.
    heading : of `Examination.heading`.
    fields : of `FIELDS`.
    trend : what each flight of the unit found, in their order, if there are several.
    """
    return {
        "format": FORMAT, "form": FORM,
        "created": datetime.now(tz=timezone.utc).isoformat(timespec="seconds"),
        "unit": {"serial_number": heading["serial_number"], "actuator_type": actuator_hash(),
                 **{name: fields.get(name, "") for name in FIELDS}},
        "test": {
            "profile": record.profile.name, "start_time": heading["start_time"],
            "duration_s": round(record.duration, 4), "samples": len(record),
            "rate_hz": round(record.rate, 3) if len(record) > 1 else None,
        },
        "outcome": OUTCOMES[verdict["verdict"]],
        "verdict": dict(verdict),
        "checks": [_check(c) for c in checks],
        "trend": [dict(one) for one in trend],
        "trace": {
            "software": f"ema_phm {VERSION}", "software_sha256": software_sha256(),
            "model_sha256": heading["model"], "kit": heading["kit"],
            "files": [*_hashes("kit", kit_files()), *_hashes("record", bag_files(
                Path(str(verdict["bag"]))))],
        },
    }


def _check(check: CheckResult) -> dict[str, Any]:
    values = []
    for name, value in check.values.items():
        stem, _, unit = name.rpartition("_")
        known = UNITS.get(unit, "")
        values.append({
            "name": stem if known else name, "unit": known, "value": value,
            "limit": None if name not in check.limits else float(f"{check.limits[name]:.4g}"),
        })
    return {"name": check.name, "outcome": CHECK_OUTCOMES[check.level], "message": check.message,
            "values": values}


def _hashes(role: str, files: Iterable[Path]) -> list[dict[str, Any]]:
    return [{"role": role, "file": path.name, "bytes": path.stat().st_size,
             "sha256": file_sha256(path)} for path in files]


def software_sha256() -> str:
    """Return the SHA-256 over names and bytes of all our modules, in order of their names."""
    digest = hashlib.sha256()
    for path in sorted(p for folder in ROOT.glob(f"{OURS}*") for p in folder.rglob("*.py")):
        digest.update(f"{path.relative_to(ROOT)}\0".encode() + path.read_bytes() + b"\0")
    return digest.hexdigest()
