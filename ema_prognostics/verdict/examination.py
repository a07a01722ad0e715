"""`examine`: a bag, its record checks and its verdict together, for whoever shows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from ema_prognostics.verdict.contract import kit_sha256
from ema_prognostics.verdict.judge import Judge
from ema_prognostics.verdict.report import verdict_of_error
from ema_prognostics.verdict.verdict import Judged, Verdict
from ema_record.bag.read import read_bag
from ema_record.checks.facts import facts_of_record
from ema_record.checks.guard import guard_findings
from ema_record.checks.live import CheckResult, check_facts
from ema_record.errors import RecordError, UsageError
from ema_record.kit import is_default_kit, kit_folder
from ema_record.record import Record
from ema_record.version import VERSION


@dataclass(frozen=True, slots=True, kw_only=True)
class Examination:
    """What one bag says.

    Attributes
    ----------
    judged : verdict on the actuator, with unit, time and test.
    record : that was read; None: it cannot be.
    checks : of the record, empty without one.
    model : SHA-256 of the networks that judged.
    """

    judged: Judged
    record: Record | None
    checks: tuple[CheckResult, ...]
    model: str

    @property
    def verdict(self) -> Verdict:
        """Of the actuator."""
        return self.judged.verdict

    @property
    def serial_number(self) -> str:
        """Of the actuator, empty where not known."""
        return _serial_number(self.record)

    @property
    def time(self) -> datetime | None:
        """Start of the test (UTC), None where not known."""
        return _time(self.record)

    def heading(self) -> dict[str, Any]:
        """Return what stands above a verdict: unit, time, test, checks, versions."""
        return heading_of(self.record, self.checks, self.model)


def _serial_number(record: Record | None) -> str:
    return "" if record is None else record.provenance.known_serial


def _time(record: Record | None) -> datetime | None:
    start = 0 if record is None else record.provenance.start_time
    return datetime.fromtimestamp(start / 1e9, tz=timezone.utc) if start else None


def heading_of(
    record: Record | None, checks: Sequence[CheckResult], model: str
) -> dict[str, Any]:
    """Return what stands above a verdict; unit, test and time are empty where not known."""
    time = _time(record)
    kit = "default kit" if is_default_kit() else f"kit {kit_folder().name}"
    return {
        "serial_number": _serial_number(record),
        "profile": "" if record is None else record.profile.name,
        "start_time": "" if time is None else time.isoformat(timespec="milliseconds"),
        "checks": [{"name": c.name, "level": int(c.level), "message": c.message}
                   for c in checks],
        "software_version": VERSION, "model": model, "kit": f"{kit} {kit_sha256()[:8]}",
    }


def examine(judge: Judge, bag: str | Path) -> Examination:
    """Read, check and judge a bag; answers for any."""
    try:
        record = judge.commanded(read_bag(bag))
    except (RecordError, UsageError) as error:
        return Examination(judged=Judged(verdict_of_error(error, str(bag))), record=None,
                           checks=(), model=judge.model_sha256)
    facts = facts_of_record(record)
    findings = guard_findings(facts)
    return Examination(
        judged=judge.of_record(record, str(bag), findings), record=record,
        checks=tuple(check_facts(facts, findings)), model=judge.model_sha256,
    )
