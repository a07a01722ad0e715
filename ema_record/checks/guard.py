"""All rules, and the guard of a verdict: what in a record forbids to judge the actuator by it.

The guard takes those rules that need the record alone: so a verdict is the same from the bag
and from the topics. What is only unusual (another recorder, a rate that is little off, a longer
record, a topic that no verdict needs) forbids nothing.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ema_record.actuator import Actuator
from ema_record.checks import origin, physics, sensors, stream, travel, values, whole_turns
from ema_record.checks.facts import BagFacts, Finding, Rule, facts_of_record
from ema_record.record import Record

RULES: tuple[Rule, ...] = (*stream.RULES, *origin.RULES, *values.RULES, *physics.RULES,
                           *sensors.RULES, *travel.RULES, *whole_turns.RULES, sensors.HELD_SAMPLES)
MAX_FINDINGS = 20
"""Most findings of one rule that are told."""

Outcome = Literal["incomplete", "invalid", "unknown"]
OUTCOMES: dict[str, Outcome] = {
    "other_actuator": "invalid",
    "test_not_complete": "incomplete", "record_length": "incomplete", "gap": "incomplete",
    "not_finite": "invalid", "missing_channel": "unknown",
    "sample_rate": "unknown", "clock_jump": "invalid",
    "repeated_data": "invalid",
    "stuck_channel": "unknown", "wrong_unit": "invalid", "sign_flip": "invalid",
    "swapped_phases": "invalid", "held_samples": "unknown", "sensor_noise": "unknown",
    "discontinuity": "invalid", "spike": "unknown", "saturation": "unknown",
    "sensor_scale": "unknown", "sensor_offset": "unknown", "wrong_profile": "invalid",
}
"""What a finding of each rule makes of the verdict; the first one in this order decides."""
SENSOR_RULES = frozenset({
    "stuck_channel", "saturation", "spike", "swapped_phases", "sensor_scale", "sensor_offset",
    "sensor_noise", "held_samples",
})
"""Rules whose finding is a fault of a transducer, its wires or its plug."""


def plain(text: str) -> str:
    """Return a text in which no number has more digits than a person reads."""
    return re.sub(r"\b\d{20,}(\.\d+)?\b", lambda number: f"{float(number[0]):g}", text)


def findings_of(facts: BagFacts, names: Collection[str]) -> list[Finding]:
    """Return what the rules of these names find, in the order of `RULES`.

    Of a record of another actuator than the kit's nothing else is told.
    """
    other = origin.OTHER_ACTUATOR
    if other.name in names and (found := other.check(facts)):
        return found
    with np.errstate(all="ignore"):  # the values of a record may be anything
        return [
            replace(finding, message=plain(finding.message))
            for rule in RULES if rule.name in names
            for finding in rule.check(facts)[:MAX_FINDINGS]
        ]


def guard_findings(
    record: Record | BagFacts, actuator: Actuator | None = None,
    names: Collection[str] = OUTCOMES,
) -> tuple[Finding, ...]:
    """Return what forbids a verdict on `record`, the deciding one first; empty: nothing.

    They are in the order of `OUTCOMES`; at most `MAX_FINDINGS` of one rule.

    Parameters
    ----------
    record : one test, or its facts. Its samples may be of any value, in any order.
    actuator : what was tested, default the kit's; facts know it.
    names : rules that are asked, of `OUTCOMES`.
    """
    facts = facts_of_record(record, actuator) if isinstance(record, Record) else record
    found = [f for f in findings_of(facts, names) if not _only_unusual(f)]
    order = list(OUTCOMES)
    return tuple(sorted(found, key=lambda finding: order.index(finding.rule)))


def _only_unusual(finding: Finding) -> bool:
    """Whether a record is merely longer than its test, or of a rate that is little off."""
    size, (least, most) = finding.size or 0.0, origin.JUDGED_RATES
    return ((finding.rule == "record_length" and size <= 0.0)
            or (finding.rule == "sample_rate" and least <= size <= most))


def outcome_of(findings: Sequence[Finding]) -> Outcome:
    """Return the verdict that `findings`, at least one, amount to."""
    return OUTCOMES[findings[0].rule]


def reason_of(finding: Finding) -> str:
    """Return a finding as one reason of a verdict."""
    kind = "sensor fault" if finding.rule in SENSOR_RULES else "record check"
    at = plain(f" at {finding.time:.3f} s") if finding.time is not None else ""
    name = finding.rule.replace("_", " ")
    return f"{kind}, {name}{at}: {finding.message}; {finding.remedy}"
