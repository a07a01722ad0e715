"""`guarded`: a verdict only on a record that can be trusted.

The record checks of `ema_record.checks` come first. What they find makes the verdict incomplete,
invalid or unknown, with the findings as its reasons; the actuator is then not judged.
"""

from __future__ import annotations

from collections.abc import Callable

from ema_prognostics.verdict.verdict import Verdict
from ema_record.actuator import Actuator
from ema_record.checks.guard import guard_findings, outcome_of, reason_of
from ema_record.record import Record

MOST_REASONS = 5
"""Findings that are told."""


def guarded(
    record: Record, judge: Callable[[Record], Verdict], actuator: Actuator | None = None
) -> Verdict:
    """Return the verdict of `judge`, or that of the record checks where they find something.

    Parameters
    ----------
    record : one built-in test.
    judge : returns the verdict on a record, for example `diagnose`.
    actuator : what was tested, default the nominal one.
    """
    findings = guard_findings(record, actuator)
    if not findings:
        return judge(record)
    outcome = outcome_of(findings)
    return Verdict(
        outcome=outcome, probabilities={"unknown": 1.0} if outcome == "unknown" else {},
        reasons=tuple(map(reason_of, findings[:MOST_REASONS])), bag=record.provenance.source,
    )
