"""Lint: defects of a recording, whatever the actuator's health.

A rule is a name, a remedy and a function from `BagFacts` to what it found. A fault of the
actuator is no defect of its recording: every bound is one that no actuator can pass. The rules
that need the record alone also guard every verdict: `guard_findings`.
"""

from ema_record.checks.facts import BagFacts, gather_facts
from ema_record.checks.finding import Finding, Rule
from ema_record.checks.guard import guard_findings, outcome_of, reason_of
from ema_record.checks.run import RULES, LintReport, lint_bag

__all__ = [
    "RULES", "BagFacts", "Finding", "LintReport", "Rule", "gather_facts", "guard_findings",
    "lint_bag", "outcome_of", "reason_of",
]
