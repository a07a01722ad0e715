"""Judging answers: what counts as right, wrong, unknown; sizes and intervals; the tables."""

import numpy as np
import pytest

from benchmarks.any_actuator.described import Damage
from benchmarks.blind_panel.judging import (
    as_written,
    holds,
    in_question,
    is_set,
    outcome,
    resolved,
    right_port,
    row_of,
    sizes_of,
    turn_of,
)
from benchmarks.blind_panel.table import (
    interval,
    not_right,
    numbers,
    seconds,
    sizes,
    table,
    visible,
)
from benchmarks.blind_panel.truth.answers import Answer
from benchmarks.blind_panel.truth.units import DAMAGES, PWM, catalogued
from ema_record.actuator import load_actuator
from ema_sim.effects import parse_effects


def finding(effect, *equivalent, choices=(), **numbers):
    """Return a finding; numbers are value, low, high."""
    return {"effect": effect, "equivalent": list(equivalent), "choices": dict(choices),
            "parameters": [
                {"name": f"{effect}.{name}", "value": value, "interval": [low, high],
                 "unit": "rad"} for name, (value, low, high) in numbers.items()]}


def said(*findings, verdict="explained", port=None, **more):
    return {"verdict": verdict, "findings": list(findings), "next_profile": None, "cpu": 1.0,
            "wall": 2.0, "unknown": None if port is None else {"port": port, "text": ""}, **more}


def hidden(*names, without=(), **truth):
    """Return the answer of a unit; `truth`: of the first name."""
    return Answer(id="a", seed=1, tests=("step",), stratum="own, one effect", k=0, names=names,
                  without=without,
                  truth={f"{names[0]}.{name}": value for name, value in truth.items()})


def insides(found, answer):
    return [row["inside"] for row in sizes_of(said(found), answer)]


@pytest.mark.parametrize(("given", "what"), [
    (said(finding("turn_short")), "right"),
    (said(finding("rotor_eccentricity", "turn_short")), "right"),
    (said(finding("backlash", "a", "b", "turn_short")), "wrong"),  # the fourth name of a set
    (said(finding("backlash")), "wrong"),
    (said(finding("turn_short"), finding("backlash")), "wrong"),
    (said(finding("turn_short"), verdict="contradicted"), "unknown"),
    (said(verdict="unknown effect", port="friction"), "unknown"),
    (said(verdict="no disagreement"), "silent"),
])
def test_one_effect(given, what):
    assert outcome(row_of(hidden("turn_short"), given)) == what


def test_nothing_hidden():
    assert outcome(row_of(hidden(), said(finding("backlash")))) == "wrong"
    assert outcome(row_of(hidden(), said(verdict="no disagreement"))) == "silent"


@pytest.mark.parametrize(("port", "right"), [
    ("commutation", True), ("winding, commutation", True), ("winding", False),
    ("load, friction, commutation", False),  # two ports at most
])
def test_stranger_of_the_catalogue(port, right):
    answer = hidden("hall_misalignment", without=("hall_misalignment",))
    row = row_of(answer, said(verdict="unknown effect", port=port))
    assert (outcome(row), right_port(row)) == ("unknown", right)


def test_stranger_that_got_a_name_is_not_unknown():
    answer = hidden("hall_misalignment", without=("hall_misalignment",))
    for name in ("backlash", "hall_misalignment"):
        row = row_of(answer, said(finding(name), verdict="partly explained", port="commutation"))
        assert (outcome(row), right_port(row)) == ("wrong", False)


def test_two_effects():
    answer = hidden("turn_short", "backlash")
    for findings, what in (
            ((finding("turn_short"), finding("x", "backlash")), "right"),
            ((finding("turn_short", "backlash"),), "part"), ((finding("backlash"),), "part"),
            ((finding("turn_short"), finding("backlash"), finding("x")), "wrong")):
        assert outcome(row_of(answer, said(*findings))) == what


def test_of_an_accepted_unit_what_has_changed_counts():
    since = said(finding("turn_short"))
    row = row_of(hidden("turn_short"), said(finding("backlash"), since_baseline=since))
    assert (outcome(row), row["named"]) == ("right", [["turn_short"]])


def test_a_test_is_wanted_for_a_set_that_proposes_one():
    both, ramps = finding("shaft_compliance", "backlash"), {"name": "ramps"}
    assert in_question(said(both, next_profile=ramps))
    assert not in_question(said(both))
    assert not in_question(said(both, verdict="contradicted", next_profile=ramps))
    assert not in_question(said(finding("backlash"), next_profile=ramps))
    row = row_of(hidden("backlash"), said(both, next_profile=ramps))
    assert (row["next"], row["seconds"], row["wall"]) == ("ramps", 1.0, 2.0)


def test_an_angle_is_the_same_whole_turns_away():
    assert holds(3.0, 3.3, 3.2 - 2.0 * np.pi, 2.0 * np.pi)
    assert not holds(3.0, 3.3, 3.2 - 2.0 * np.pi)


def test_an_eccentricity_of_the_other_sign_points_the_other_way():
    answer = hidden("rotor_eccentricity", zeta=-0.03, mode="common", angle=1.0, phase="c")
    found = finding("rotor_eccentricity", choices={"rotor_eccentricity.mode": "common"},
                    zeta=(0.031, 0.02, 0.04), angle=(4.1, 4.0, 4.3))
    assert insides(found, answer) == [True, True]


def test_numbers_of_another_mode_are_not_compared():
    answer = hidden("rotor_eccentricity", zeta=0.03, mode="common", angle=1.0)
    found = finding("rotor_eccentricity", choices={"rotor_eccentricity.mode": "shifted"},
                    zeta=(0.031, 0.02, 0.04), angle=(1.0, 0.9, 1.1))
    assert insides(found, answer) == [None, None]


def test_what_is_fitted_but_not_hidden_is_truly_nothing():
    answer = hidden("inertia_change", motor=0.5)
    assert insides(finding("inertia_change", surface=(2.0, 1.5, 2.5)), answer) == [False]


def test_a_ripple_of_other_periods_is_another_law():
    answer = hidden("cogging_torque", amplitude=0.03, periods=12.0, phase=0.5)
    for periods, inside in ((12.0, [True, False]), (9.0, [None, None])):
        found = finding("cogging_torque", amplitude=(0.03, 0.02, 0.04), phase=(0.1, 0.0, 0.2),
                        periods=(periods, periods, periods))
        assert insides(found, answer) == inside


def test_no_sizes_of_a_name_that_is_wrong_or_not_in_the_catalogue():
    found = finding("backlash", increase=(1.0, 0.0, 2.0))
    assert insides(found, hidden("hall_misalignment")) == []
    assert insides(found, hidden("backlash", without=("backlash",), increase=1.0)) == []


@pytest.mark.parametrize("name", DAMAGES)
def test_damages_of_the_second_simulator_are_laws_of_the_catalogue(name):
    a = load_actuator()
    truth = catalogued(a, name, Damage(phase=1, angle=0.3))
    parse_effects([f"{key}={value}" for key, value in truth.items()])
    assert as_written(truth, name).keys() >= truth.keys()


def test_with_several_pole_pairs_an_angle_is_the_same_from_each_turn_on():
    turn = 2.0 * np.pi / 5.0  # five of them
    assert turn_of(PWM, "rotor_eccentricity", {}) == pytest.approx(turn)
    cogging, mesh = {"cogging_torque.periods": 30.0}, {"gear_mesh_ripple.periods": 17.0}
    assert turn_of(PWM, "cogging_torque", cogging) == pytest.approx(5.0 * turn)
    assert turn_of(PWM, "gear_mesh_ripple", mesh) == pytest.approx(turn)
    assert turn_of(PWM, "hall_misalignment", {}) == pytest.approx(2.0 * np.pi)


def row(named, verdict="explained", names=("backlash",), **more):
    return {"k": 0, "names": names, "strange": False, "verdict": verdict, "named": named,
            "port": "", "seconds": 1.0, "wall": 2.0, "next": None, "sizes": [], **more}


def test_sets_and_the_tests_that_resolve_them():
    one, many = row([["backlash"]]), row([["shaft_compliance", "backlash"]], next="ramps")
    assert (outcome(one), is_set(one), resolved(one)) == ("right", False, True)
    assert (outcome(many), is_set(many), resolved(many)) == ("right", True, False)
    text = numbers({"own, one effect": [one, many]}, {"own, one effect": [(many, one)]})
    assert "1 (2.5-100 %) of 1, >= 85 %; 1 sets, 1 with a command" in text


def test_tables_of_what_there_is():
    size = {"name": "backlash.increase", "true": 1.0, "value": 1.1, "low": 0.9, "high": 1.2,
            "inside": True}
    rows = {"own, nothing": [row([], "no disagreement", ())] * 200,
            "own, one effect": [row([["backlash"]], sizes=[size])],
            "second, one effect": [row([["backlash"]], sizes=[{**size, "inside": None}])]}
    assert interval(0, 200) == "0 (0-1.83 %)"
    assert "| own, nothing | 200 |" in table(rows)
    assert "0 (0-1.83 %) of 200, <= 1 %" in numbers(rows, {})
    assert "| backlash | 1 (2.5-100 %) of 1, 10 % | - of 0; 1 of another mode |" in sizes(rows)
    assert "| all | 202 | 1.0 | 2.0 | 2.0 |" in seconds(rows)


def test_units_that_are_not_as_they_should_be_are_listed():
    rows = {"own, nothing": [row([], "no disagreement", ()), row([["backlash"]], names=(), k=1)],
            "own, one effect": [row([["backlash"]]), row([["a", "b"], ["c"]], k=1)],
            "own, outside the catalogue": [row([], "unknown effect", strange=True),
                                           row([], "no disagreement", strange=True, k=1)]}
    assert not_right(rows).splitlines()[2:] == [
        "| own, nothing | 1 | nothing | explained | backlash |",
        "| own, one effect | 1 | backlash | explained | a/b; c |",
        "| own, outside the catalogue | 1 | backlash | no disagreement | - |"]


def test_an_effect_below_three_floors_is_not_visible():
    rows = [("own, one effect", row([["backlash"]]), 9.0),
            ("own, one effect", row([], "no disagreement"), 2.9)]
    assert visible(rows).splitlines()[-1] == (
        "| own, one effect | 2 | 1 | 1 | backlash 2.9 silent |")
