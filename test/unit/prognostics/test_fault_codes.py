"""The verdict as others consume it: a code a fault, a level, stamps and units."""

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus

from ema_prognostics.node.messages import (
    FAULTS,
    NOT_JUDGED,
    fault_codes,
    fault_statuses,
    verdict_status,
)
from ema_prognostics.verdict.verdict import Fault, Judged, Verdict
from ema_record.kit import share_path
from ema_ros.messages import values_of

SHORT = Fault(fault_class="turn_short", phase="b", severity=0.1, severity_unit="1",
              severity_interval=(0.09, 0.11), level="medium")
FRICTION = Fault(fault_class="friction", severity=1.4, severity_unit="1")


@pytest.mark.parametrize(("verdict", "codes", "level"), [
    (Verdict(outcome="healthy"), [], DiagnosticStatus.OK),
    (Verdict(outcome="fault", faults=(SHORT,)), ["EMA_TURN_SHORT_B"], DiagnosticStatus.ERROR),
    (Verdict(outcome="fault", faults=(SHORT, FRICTION)), ["EMA_TURN_SHORT_B", "EMA_FRICTION"],
     DiagnosticStatus.ERROR),
    (Verdict(outcome="unknown"), ["EMA_UNKNOWN"], DiagnosticStatus.WARN),
    (Verdict(outcome="incomplete"), ["EMA_INCOMPLETE"], DiagnosticStatus.WARN),
    (Verdict(outcome="invalid"), ["EMA_INVALID"], DiagnosticStatus.ERROR),
])
def test_codes_and_levels(verdict, codes, level):
    as_json = verdict.to_dict()
    assert fault_codes(as_json) == codes
    status = verdict_status("/left/ema_prognostics: verdict", as_json, Judged(verdict, "EMA-1", 5))
    values = values_of(status)
    assert values["fault_code"] == "".join(codes[:1])
    assert values["fault_codes"] == ", ".join(codes)
    assert status.level == level
    assert (status.name, status.hardware_id) == ("/left/ema_prognostics: verdict", "EMA-1")
    assert int(values["stamp"]) > 1_700_000_000 * 10**9
    assert values["test_stamp"] == "5"


def test_a_severity_has_its_unit_and_interval():
    verdict = Verdict(outcome="fault", faults=(SHORT,))
    status = verdict_status("verdict", verdict.to_dict(), Judged(verdict))
    assert status.message == "turn_short, phase b, 10 %"
    values = values_of(status)
    assert {key: values[key] for key in (
        "severity", "severity_unit", "severity_lower", "severity_upper")} == {
        "severity": "0.1", "severity_unit": "1", "severity_lower": "0.09",
        "severity_upper": "0.11"}


def levels(**fields):
    verdict = Verdict(**fields).to_dict()
    return {status.name.removeprefix("ema: "): status.level
            for status in fault_statuses("", verdict, "EMA-1")}


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def test_healthy_clears_every_fault_that_it_rules_out():
    found = levels(outcome="healthy", alternatives=("backlash", "turn_short"))
    assert set(found) == {*FAULTS, *NOT_JUDGED} - {
        "backlash", "turn_short_a", "turn_short_b", "turn_short_c"}
    assert set(found.values()) == {OK}


def test_a_fault_is_its_own_status_and_clears_no_class_that_looks_like_it():
    found = levels(outcome="fault", faults=(SHORT,), alternatives=("rotor_eccentricity",))
    assert found.pop("turn_short_b") == ERROR
    assert "rotor_eccentricity" not in found
    assert set(found) == {"turn_short_a", "turn_short_c", "friction", "backlash", *NOT_JUDGED}
    assert set(found.values()) == {OK}


@pytest.mark.parametrize(("outcome", "level"), [
    ("unknown", WARN), ("incomplete", WARN), ("invalid", ERROR)])
def test_what_was_not_judged_clears_no_fault(outcome, level):
    found = levels(outcome=outcome)
    assert found.pop(outcome) == level
    assert set(found) == set(NOT_JUDGED) - {outcome}
    assert set(found.values()) == {OK}


def test_the_bridge_of_medkit_knows_each_name_by_its_code():
    """Its rule: the parameter ``name_to_code.<name of the status>`` is the fault's code."""
    path = share_path("config/diagnostics/medkit.yaml")
    given = yaml.safe_load(path.read_text())["diagnostic_bridge"]["ros__parameters"]
    codes = {name.removeprefix("name_to_code."): code for name, code in given.items()
             if name.startswith("name_to_code.")}
    published = {}
    for fields in ({"outcome": "healthy"}, {"outcome": "fault", "faults": (SHORT, FRICTION)},
                   *({"outcome": outcome} for outcome in NOT_JUDGED)):
        for status in fault_statuses("", Verdict(**fields).to_dict(), ""):
            values = values_of(status)
            published[status.name] = values["fault_code"]
    assert codes == published


@pytest.mark.parametrize("namespace", ["", "/left_aileron/"])
def test_the_aggregator_sorts_every_status_into_one_place(namespace):
    """Its rule: an analyser takes each status whose name contains one of its texts."""
    path = share_path("config/diagnostics/aggregator.yaml")
    analyzers = yaml.safe_load(path.read_text())["analyzers"]["ros__parameters"]
    names = ["ema_sim: actuator", "ema_monitor: test", "ema_prognostics: node",
             "ema_prognostics: verdict", *(f"ema: {name}" for name in (*FAULTS, *NOT_JUDGED))]
    for name in names:
        places = [key for key, given in analyzers.items() if isinstance(given, dict)
                  and any(text in namespace + name for text in given["contains"])]
        assert len(places) == 1, (name, places)
