"""`lint_bag`: all rules on one bag."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ema_record.actuator import Actuator, load_actuator
from ema_record.bag.metadata import RECOVERY, START
from ema_record.bag.read import Recording
from ema_record.checks.facts import BagFacts, Finding
from ema_record.checks.guard import RULES, findings_of
from ema_record.errors import RecordError
from ema_record.wire.topics import DC_BUS, WEIGHT_ON_WHEELS, WINDING_TEMPERATURE


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


def lint_bag(path: str | Path, actuator: Actuator | None = None) -> LintReport:
    """Return what all rules find in a bag; one that cannot be read is told, not raised.

    `actuator` is what was tested, default the kit's.
    """
    try:
        bag = Recording(path, (WEIGHT_ON_WHEELS,), as_recorded=True)
        blocks, content = bag.blocks(), bag.content
        facts = BagFacts(
            actuator=load_actuator() if actuator is None else actuator, blocks=blocks,
            said=bag.test.profile, provenance=bag.test.provenance,
            command=bag.command(blocks) if blocks else None,
            bus_voltage=bag.slow(DC_BUS)[:, 1],
            winding_temperature=bag.slow(WINDING_TEMPERATURE)[:, 1],
            topics=frozenset(topic for topic, found in content.messages.items() if found),
            has_start=START in content.metadata, recovered=content.metadata.get(RECOVERY),
            weight_on_wheels=[bool(said.data) for _, said in bag.decoded(WEIGHT_ON_WHEELS)],
            errors=bag.errors,
        )
    except RecordError as error:
        return LintReport(bag=str(path), findings=(), unreadable=str(error))
    findings = findings_of(facts, {rule.name for rule in RULES})
    return LintReport(bag=str(path), findings=tuple(findings))
