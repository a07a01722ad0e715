"""The verdict as a JSON object, and exit statuses."""

import json

import pytest

from ema_prognostics.verdict.verdict import Fault, Verdict, worst_status

KEYS = [
    "bag", "verdict", "fault_class", "phase", "severity", "severity_unit", "severity_interval",
    "level", "faults", "alternatives", "probabilities", "reasons", "cause", "evidence", "side",
]
SHORT = Fault(
    fault_class="turn_short", phase="b", severity=0.1 + 0.2, severity_unit="1",
    severity_interval=(0.25, 1 / 3), level="large",
)


@pytest.mark.parametrize("outcome", ["healthy", "fault", "unknown", "incomplete", "invalid"])
def test_every_key_is_always_there(outcome):
    found = Verdict(outcome=outcome).to_dict()
    assert list(found) == KEYS
    assert found["fault_class"] is None
    assert found["faults"] == []
    json.dumps(found, allow_nan=False)


def test_a_fault_and_its_rounding():
    found = Verdict(outcome="fault", faults=(SHORT,), probabilities={"healthy": 1 / 3}).to_dict()
    assert (found["fault_class"], found["phase"], found["severity"]) == ("turn_short", "b", 0.3)
    assert found["severity_interval"] == [0.25, 0.333333]
    assert found["probabilities"] == {"healthy": 0.333333}
    (fault,) = found["faults"]
    assert fault == {name: found[name] for name in fault}
    assert list(fault) == KEYS[2:8]


def test_two_faults_are_listed_largest_first():
    found = Verdict(outcome="fault", faults=(SHORT, Fault(fault_class="friction"))).to_dict()
    assert [f["fault_class"] for f in found["faults"]] == ["turn_short", "friction"]
    assert found["fault_class"] == "turn_short"


@pytest.mark.parametrize(
    ("statuses", "worst"),
    [([0, 0], 0), ([0, 3], 3), ([3, 1], 1), ([1, 2, 3], 2), ([], 0), ([0, 1, 0], 1),
     ([1, 4, 3, 0], 4), ([4, 2, 1], 2)],
)
def test_the_worst_of_several_bags(statuses, worst):
    assert worst_status(statuses) == worst
