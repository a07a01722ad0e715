"""Verdicts of the product on cases, kept line by line so that a run can go on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.any_actuator.cases import BenchCase
from benchmarks.any_actuator.records import record_of
from benchmarks.ledger import Ledger
from ema_prognostics.features.extract import extract
from ema_prognostics.features.profile_kind import profile_kind
from ema_prognostics.verdict.judge import Judge
from ema_record.actuator_type import actuator_hash
from ema_record.errors import RecordError
from ema_record.kit import CASCADE, kit_path
from ema_record.profile import Profile
from ema_record.record import Record
from ema_record.sources import source_hash


def judge_cases(
    cases: Sequence[BenchCase], profile: Profile, judge: Judge, ledger: Ledger, name: str,
    progress: Callable[[int, int], None] = lambda _done, _all: None, *, features: bool = False,
) -> list[dict[str, Any]]:
    """Return what `ema check` says of each case, simulated when its verdict is not there yet.

    Parameters
    ----------
    cases, profile : the fleet and its test.
    judge : of the present kit.
    ledger, name : keep the verdicts; `name` says what decides them beside the case: `decided_by`.
    progress : called with cases done and all cases.
    features : keep the features of each record too, where it gives any.
    """
    rows = []
    for n, case in enumerate(cases):
        rows.append(ledger.run(
            f"{name}/{case.key}", partial(_judged, case, profile, judge, features)))
        progress(n + 1, len(cases))
    return rows


def _judged(case: BenchCase, profile: Profile, judge: Judge, features: bool) -> dict[str, Any]:
    record = record_of(case.test, profile)
    verdict = judge.of_record(record, case.key).verdict
    found = verdict.to_dict()
    return {
        "features": _features(record) if features else None,
        "group": case.group, "detail": case.detail, "size": case.size, "phase": case.phase,
        "outcome": verdict.outcome, "named": [f.fault_class for f in verdict.faults],
        "alternatives": list(verdict.alternatives), "named_phase": found["phase"],
        "severity": found["severity"], "interval": found["severity_interval"],
        "reasons": list(verdict.reasons[:3]),
    }


def _features(record: Record) -> dict[str, float] | None:
    try:
        kind = profile_kind(record.profile)
        return None if kind is None else extract(record, kind)
    except RecordError:
        return None


SOURCES = ("described", "physics", "records", "units", "cases")
"""What decides a record, beside the description of the actuator."""


def decided_by(*parts: object) -> str:
    """Return 16 digits that name verdicts in a ledger.

    Of `parts`, the present kit (actuator and cascade), and the code of both sides.
    """
    digest = hashlib.sha256(source_hash("ema_prognostics.verdict.judge").encode())
    for name in SOURCES:
        digest.update(Path(__file__).with_name(f"{name}.py").read_bytes())
    digest.update(f"{actuator_hash()} {file_key(kit_path(CASCADE))} {parts}".encode())
    return digest.hexdigest()[:16]


def file_key(path: Path) -> str:
    """Return 12 digits of a file's hash, ``none`` where there is none."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12] if path.is_file() else "none"
