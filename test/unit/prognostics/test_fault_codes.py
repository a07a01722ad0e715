"""The verdict as others consume it: a code a fault, a level, stamps and units."""

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from ema_prognostics.node.messages import fault_codes, verdict_status
from ema_prognostics.verdict.judge import Judged
from ema_prognostics.verdict.verdict import Fault, Verdict

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
    values = {pair.key: pair.value for pair in status.values}
    assert values["fault_code"] == "".join(codes[:1])
    assert values["fault_codes"] == ", ".join(codes)
    assert status.level == level
    assert (status.name, status.hardware_id) == ("/left/ema_prognostics: verdict", "EMA-1")
    assert int(values["stamp"]) > 1_700_000_000 * 10**9
    assert values["test_stamp"] == "5"


def test_a_severity_has_its_unit_and_interval():
    verdict = Verdict(outcome="fault", faults=(SHORT,))
    status = verdict_status("verdict", verdict.to_dict(), Judged(verdict))
    values = {pair.key: pair.value for pair in status.values}
    assert {key: values[key] for key in (
        "severity", "severity_unit", "severity_lower", "severity_upper")} == {
        "severity": "0.1", "severity_unit": "1", "severity_lower": "0.09",
        "severity_upper": "0.11"}
