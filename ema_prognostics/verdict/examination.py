"""`examine`: a bag, its record checks and its verdict together, for whoever shows them."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from ema_prognostics.verdict.judge import UNKNOWN_SERIAL, Judge
from ema_prognostics.verdict.report import verdict_of_error
from ema_prognostics.verdict.verdict import Verdict
from ema_record.actuator_type import actuator_hash
from ema_record.bag.read import read_bag
from ema_record.checks.facts import facts_of_record
from ema_record.checks.guard import guard_findings
from ema_record.checks.live import CheckResult, Level, check_facts
from ema_record.errors import RecordError, UsageError
from ema_record.kit import is_default_kit, kit_folder
from ema_record.record import Record
from ema_record.version import VERSION


@dataclass(frozen=True, slots=True, kw_only=True)
class Examination:
    """What one bag says.

    Attributes
    ----------
    verdict : of the actuator.
    record : that was read; None: it cannot be.
    checks : of the record, empty without one.
    model : SHA-256 of the networks that judged.
    """

    verdict: Verdict
    record: Record | None
    checks: tuple[CheckResult, ...]
    model: str

    @property
    def serial_number(self) -> str:
        """Of the actuator, empty where not known."""
        said = "" if self.record is None else self.record.provenance.serial_number
        return "" if said == UNKNOWN_SERIAL else said

    @property
    def time(self) -> datetime | None:
        """Start of the test (UTC), None where not known."""
        start = 0 if self.record is None else self.record.provenance.start_time
        return datetime.fromtimestamp(start / 1e9, tz=timezone.utc) if start else None

    @property
    def profile(self) -> str:
        """Name of the test, empty where not known."""
        return "" if self.record is None else self.record.profile.name

    def heading(self) -> dict[str, Any]:
        """Return what stands above a verdict: unit, time, test, checks, versions."""
        time = self.time
        return {
            "serial_number": self.serial_number, "profile": self.profile,
            "start_time": "" if time is None else time.isoformat(timespec="milliseconds"),
            "checks": [{"name": c.name, "level": int(c.level), "message": c.message}
                       for c in self.checks],
            "software_version": VERSION, "model": self.model, "kit": kit_text(),
        }


def kit_text() -> str:
    """Return the present kit and its actuator's hash, short."""
    name = "default kit" if is_default_kit() else f"kit {kit_folder().name}"
    return f"{name} {actuator_hash()[:8]}"


def examine(judge: Judge, bag: str | Path) -> Examination:
    """Read, check and judge a bag; answers for any."""
    try:
        record = judge.commanded(read_bag(bag))
    except (RecordError, UsageError) as error:
        return Examination(verdict=verdict_of_error(error, str(bag)), record=None, checks=(),
                           model=judge.model_sha256)
    facts = facts_of_record(record)
    findings = guard_findings(facts)
    return Examination(
        verdict=judge.of_record(record, str(bag), findings).verdict, record=record,
        checks=tuple(check_facts(facts, findings)), model=judge.model_sha256,
    )


def passed(checks: list[dict[str, Any]]) -> int:
    """Return how many of the checks of a heading are in order."""
    return sum(check["level"] == Level.OK for check in checks)
