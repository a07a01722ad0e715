"""Judging answers: what counts as right, wrong, unknown, both, closed, covered."""

import pytest

from benchmarks.blind_panel.judge import judge
from benchmarks.blind_panel.table import counted, table, text
from benchmarks.blind_panel.truth.cases import draw_cases

SEEN = {"x": (9.0, "block")}


def finding(effect, *equivalent, parameters=()):
    return {"effect": effect, "equivalent": list(equivalent), "parameters": list(parameters)}


def answer(*findings, verdict="explained", unknown=None, after=1.0):
    return {"verdict": verdict, "findings": list(findings), "unknown": unknown, "seconds": 2.0,
            "gap_before": 11.0, "gap_after": after, "noise_floor": 1.0}


@pytest.fixture(scope="module")
def cases():
    found = draw_cases(7)
    return {
        "short": next(c for c in found if c.names == ("turn_short",) and c.group == "effect"),
        "nothing": next(c for c in found if c.group == "nothing"),
        "pair": next(c for c in found if c.group == "pair"),
        "hidden": next(c for c in found if c.without == ("hall_misalignment",)),
        "foreign": next(c for c in found if c.foreign == "integral_gain"),
    }


@pytest.mark.parametrize(("given", "right", "wrong"), [
    (answer(finding("turn_short")), True, False),
    (answer(finding("rotor_eccentricity", "turn_short")), True, False),
    (answer(finding("backlash", "turn_short", "a", "b")), False, False),  # a set of four
    (answer(finding("backlash")), False, True),
    (answer(finding("turn_short"), finding("backlash")), False, True),
    (answer(verdict="no disagreement"), False, False),
])
def test_one_effect(cases, given, right, wrong):
    found = judge(cases["short"], given, SEEN)
    assert (found.right, found.wrong, found.visible) == (right, wrong, True)


def test_an_effect_below_three_floors_is_not_visible(cases):
    assert not judge(cases["short"], answer(), {"x": (2.9, "block")}).visible


def test_nothing_hidden(cases):
    assert judge(cases["nothing"], answer(finding("backlash")), {}).named
    quiet = judge(cases["nothing"], answer(verdict="no disagreement"), {})
    assert (quiet.named, quiet.right, quiet.wrong) == (False, None, None)


@pytest.mark.parametrize(("port", "strict", "lenient"), [
    ("commutation", True, True), ("winding, commutation", True, True),
    ("winding", False, True), ("friction", False, False),
    ("load, friction, commutation", False, False),  # two ports at most
])
def test_stranger_of_the_catalogue(cases, port, strict, lenient):
    given = answer(verdict="unknown effect", unknown={"port": port, "text": ""})
    found = judge(cases["hidden"], given, SEEN)
    assert (found.unknown_port, found.unknown_balance) == (strict, lenient)


def test_stranger_that_got_a_name_is_not_unknown(cases):
    given = answer(finding("backlash"), verdict="partly explained",
                   unknown={"port": "controller", "text": ""})
    found = judge(cases["foreign"], given, SEEN)
    assert (found.unknown_port, found.named) == (False, True)


def test_two_effects(cases):
    first, second = cases["pair"].names
    assert judge(cases["pair"], answer(finding(first), finding("x", second)), SEEN).both
    assert not judge(cases["pair"], answer(finding(first, second)), SEEN).both
    assert not judge(cases["pair"], answer(finding(first)), SEEN).both
    three = answer(finding(first), finding(second), finding("x"))
    assert judge(cases["pair"], three, SEEN).both is False


def test_gap_closed_and_interval(cases):
    truth = cases["short"].settings["turn_short.fraction"]
    inside = {"name": "turn_short.fraction", "interval": [0.9 * truth, 1.1 * truth]}
    outside = {"name": "turn_short.fraction", "interval": [1.1 * truth, 1.2 * truth]}
    found = judge(cases["short"], answer(finding("turn_short", parameters=[inside, outside]),
                                         after=2.0), SEEN)
    assert found.closed == pytest.approx(0.9)
    assert found.covered == (True, False)


def test_a_set_is_resolved_by_the_right_name_alone(cases):
    given = answer(finding("turn_short", "rotor_eccentricity"))
    again = answer(finding("turn_short"))
    assert judge(cases["short"], given, SEEN, again).resolved is True
    assert judge(cases["short"], given, SEEN, given).resolved is False
    assert judge(cases["short"], again, SEEN, again).resolved is None


def test_a_set_without_a_proposed_test_is_counted_apart(cases):
    given = answer(finding("turn_short", "rotor_eccentricity"))
    assert judge(cases["short"], given, SEEN).without_test is True
    assert judge(cases["short"], given, SEEN).resolved is None
    assert judge(cases["short"], {**given, "next_profile": {}}, SEEN).without_test is True
    assert judge(cases["short"], {**given, "next_profile": {"name": "ramps"}}, SEEN).without_test \
        is False
    assert judge(cases["short"], answer(finding("turn_short")), SEEN).without_test is None


def test_bounds_are_exact():
    none, half = counted([False] * 200), counted([True, False] * 5)
    assert (none.lower, none.upper) == pytest.approx((0.0, 1.0 - 0.025 ** (1 / 200)))
    assert (half.lower, half.upper) == pytest.approx((0.187, 0.813), abs=1e-3)
    assert text(counted([True, None, False, True])) == "67 % [9, 99] 2/3"
    assert text(counted([None])) == "–"


def test_table_has_a_column_a_method(cases):
    judged = [judge(cases["short"], answer(finding("turn_short")), SEEN),
              judge(cases["nothing"], answer(finding("backlash")), {})]
    text = table({"ours": judged, "peer": judged[:1]})
    assert "100 % [3, 100] 1/1" in text
    assert text.splitlines()[0].split() == ["what", "target", "ours", "peer"]
    assert text.splitlines()[-1].split() == ["units", "judged", "2", "1"]
