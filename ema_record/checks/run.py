"""`lint_bag`: all rules on one bag."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ema_record.checks import origin, physics, sensors, stream, values
from ema_record.checks.facts import gather_facts
from ema_record.checks.finding import Finding, Rule
from ema_record.errors import RecordError

RULES: tuple[Rule, ...] = (*stream.RULES, *origin.RULES, *values.RULES, *physics.RULES,
                           *sensors.RULES)
MAX_FINDINGS = 20
"""Most findings of one rule that are told."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LintReport:
    """What was found in one bag."""

    bag: str
    findings: tuple[Finding, ...]
    unreadable: str | None = None
    """Why the bag cannot be read; None: it can."""

    @property
    def exit_status(self) -> int:
        """0 clean, 1 findings, 2 unreadable."""
        return 2 if self.unreadable is not None else 1 if self.findings else 0

    def to_dict(self) -> dict[str, object]:
        """Return the report as plain types."""
        return {
            "bag": self.bag, "clean": self.exit_status == 0, "unreadable": self.unreadable,
            "findings": [finding.to_dict() for finding in self.findings],
        }


def lint_bag(path: str | Path) -> LintReport:
    """Return what all rules find in a bag; one that cannot be read is told, not raised."""
    try:
        facts = gather_facts(path)
    except RecordError as error:
        return LintReport(bag=str(path), findings=(), unreadable=str(error))
    with np.errstate(all="ignore"):  # the values of a bag may be anything
        findings = [f for rule in RULES for f in rule.check(facts)[:MAX_FINDINGS]]
    return LintReport(bag=str(path), findings=tuple(findings))
