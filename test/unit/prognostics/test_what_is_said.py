"""From what the cascade found to the verdict: order, phase, side, alternatives, causes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ema_prognostics.cascade.classes import CLASS_OF, OUTPUTS, levels_of
from ema_prognostics.cascade.find import Detection, Severity
from ema_prognostics.cascade.guard import BESIDE_OWN
from ema_prognostics.verdict.report import verdict_of_detection, verdict_of_error, verdict_of_guard
from ema_prognostics.verdict.verdict import Verdict
from ema_record.errors import IncompleteRecordError, InvalidRecordError, RigRecordError

MEASURED = SimpleNamespace(swings=False, strongest=lambda classes, least=2.0: [])
CASCADE = SimpleNamespace(
    guard=SimpleNamespace(checked=np.array([0, 1]), groups=("vibration",)),
    inputs=SimpleNamespace(input_names=["inertia", "rise_full"]))


def detected(*outputs: str, sizes: tuple[float, ...] = (), margin: float = -1.0,
             **more: object) -> Detection:
    p = np.array([0.9 if o in outputs else 0.01 for o in OUTPUTS])
    sizes = sizes or tuple(levels_of(CLASS_OF[o])[0] for o in outputs)
    values = {"guard": np.zeros(4), "stranger": 0.0, "stranger_kind": "", "known": 0.95,
              "doubtful": False, "probability": p, **more}
    return Detection(
        outputs=outputs, margin=np.full(5, margin), severity=tuple(
            Severity(value=s, lower=0.9 * s, upper=1.2 * s) for s in sizes), **values)


def said(*outputs: str, kind: str = "extended", **more: object) -> Verdict:
    return verdict_of_detection(MEASURED, detected(*outputs, **more), kind)


@pytest.mark.parametrize("swap", [1, -1])
def test_the_fault_nearer_to_large_is_the_first_whatever_its_unit(swap):
    """A lost motion in rad is a small number beside a part of a friction."""
    (_, play), (_, rough) = levels_of("backlash"), levels_of("friction")
    outputs, sizes = ("motor_friction", "backlash")[::swap], (0.5 * rough, 0.9 * play)[::swap]
    verdict = said(*outputs, sizes=sizes)
    assert [f.fault_class for f in verdict.faults] == ["backlash", "friction"]
    assert verdict.faults[0].severity == pytest.approx(0.9 * play)
    assert verdict.faults[0].severity_interval == pytest.approx((0.81 * play, 1.08 * play))


@pytest.mark.parametrize(("outputs", "others", "phase"), [
    (("short_b",), ("rotor_eccentricity",), "b"),
    (("static_eccentricity",), ("turn_short",), None), (("eccentricity",), (), None),
    (("backlash",), (), None),
    (("short_c", "eccentricity"), (), "c")])
def test_what_gives_the_same_lines_is_an_alternative_unless_it_is_named(outputs, others, phase):
    verdict = said(*outputs)
    assert verdict.outcome == "fault" and verdict.alternatives == others
    assert {f.phase for f in verdict.faults} - {None} == ({phase} - {None})


@pytest.mark.parametrize("side", ["motor", "surface"])
def test_the_side_of_a_friction_is_told(side):
    verdict = said(f"{side}_friction")
    assert verdict.side == side and side in verdict.reasons[0]


def test_one_step_rules_out_neither_lost_motion_nor_friction():
    step, extended = said(kind="step"), said(kind="extended")
    assert step.alternatives == ("backlash", "friction") and extended.alternatives == ()
    assert (len(step.reasons), len(extended.reasons)) == (3, 1)


@pytest.mark.parametrize(("margin", "cause"), [(1.0, "too_small"), (-1.0, "doubt")])
def test_doubt_names_what_is_nearly_as_likely(margin, cause):
    p = np.array([{"short_b": 0.4, "backlash": 0.3, "eccentricity": 0.1}.get(o, 0.0)
                  for o in OUTPUTS])
    verdict = said(margin=margin, doubtful=True, probability=p)
    assert (verdict.outcome, verdict.cause) == ("unknown", cause)
    assert verdict.alternatives == ("turn_short", "backlash")


def test_strangers_are_no_matter_of_a_guard_beside_another():
    strange = detected(stranger=2.0, stranger_kind="sag")
    assert verdict_of_guard(CASCADE, strange).cause == "unlike"
    assert verdict_of_guard(CASCADE, strange, BESIDE_OWN) is None
    far = detected(guard=np.array([0.2, 1.3, 0.0, 0.0]))
    verdict = verdict_of_guard(CASCADE, far, BESIDE_OWN, cause="unlike_since_baseline")
    assert verdict.cause == "unlike_since_baseline"
    assert [e.feature for e in verdict.evidence] == ["rise_full"]
    assert verdict_of_guard(CASCADE, detected(guard=np.full(4, 0.99))) is None


def test_the_guard_tells_what_is_off_the_most_first():
    verdict = verdict_of_guard(CASCADE, detected(guard=np.array([1.1, 1.3, 1.2, 9.0])))
    assert [(e.feature, e.times) for e in verdict.evidence] == [
        ("rise_full", 1.3), ("inertia", 1.1), ("group.vibration", 1.2)]
    verdict = verdict_of_guard(CASCADE, detected(guard=np.array([0.0, 0.0, 0.0, 1.4])))
    assert [(e.feature, e.times) for e in verdict.evidence] == [("all", 1.4)]


@pytest.mark.parametrize(("error", "outcome", "cause"), [
    (IncompleteRecordError("x"), "incomplete", "record"),
    (InvalidRecordError("x"), "invalid", "record"), (RigRecordError("x"), "invalid", "rig")])
def test_what_cannot_be_read(error, outcome, cause):
    verdict = verdict_of_error(error, "a bag")
    assert (verdict.outcome, verdict.cause, verdict.bag) == (outcome, cause, "a bag")
