"""The panel of `ema identify`: how an answer is judged, and what its tables count."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.any_actuator.described import Damage
from benchmarks.blind_panel.truth.hidden import HARD_TO_TELL
from benchmarks.decisions import visible
from benchmarks.decisions.__main__ import run, units_of
from benchmarks.decisions.judging import (
    answered,
    as_written,
    holds,
    is_set,
    outcome,
    resolved,
    sizes_of,
    turn_of,
)
from benchmarks.decisions.table import interval, numbers, seconds, sizes, table
from benchmarks.decisions.units import DAMAGES, PWM, STRATA, catalogued
from benchmarks.ledger import Ledger
from ema_identification.result import Parameter
from ema_record.actuator import load_actuator
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects


def found(effect, choices=(), **numbers):
    """Return an answer that names one effect."""
    return SimpleNamespace(findings=(SimpleNamespace(
        effect=effect, equivalent=(), choices=dict(choices), parameters=tuple(
            Parameter(name=f"{effect}.{name}", value=value, low=low, high=high, unit="rad")
            for name, (value, low, high) in numbers.items())),))


def unit(*names, **truth):
    return SimpleNamespace(names=names, without=(), kit=None, truth={
        f"{names[0]}.{name}": value for name, value in truth.items()})


def insides(answer, of):
    return [row["inside"] for row in sizes_of(answer, of)]


def test_an_angle_is_the_same_whole_turns_away():
    assert holds(3.0, 3.3, 3.2 - 2.0 * np.pi, 2.0 * np.pi)
    assert not holds(3.0, 3.3, 3.2 - 2.0 * np.pi)


def test_an_eccentricity_of_the_other_sign_points_the_other_way():
    hidden = unit("rotor_eccentricity", zeta=-0.03, mode="common", angle=1.0, phase="c")
    answer = found("rotor_eccentricity", {"rotor_eccentricity.mode": "common"},
                   zeta=(0.031, 0.02, 0.04), angle=(4.1, 4.0, 4.3))
    assert insides(answer, hidden) == [True, True]


def test_numbers_of_another_mode_are_not_compared():
    hidden = unit("rotor_eccentricity", zeta=0.03, mode="common", angle=1.0)
    answer = found("rotor_eccentricity", {"rotor_eccentricity.mode": "shifted"},
                   zeta=(0.031, 0.02, 0.04), angle=(1.0, 0.9, 1.1))
    assert insides(answer, hidden) == [None, None]


def test_what_is_fitted_but_not_hidden_is_truly_nothing():
    hidden = unit("inertia_change", motor=0.5)
    assert insides(found("inertia_change", surface=(2.0, 1.5, 2.5)), hidden) == [False]


def test_a_ripple_of_other_periods_is_another_law():
    hidden = unit("cogging_torque", amplitude=0.03, periods=12.0, phase=0.5)
    for periods, inside in ((12.0, [True, False]), (9.0, [None, None])):
        answer = found("cogging_torque", amplitude=(0.03, 0.02, 0.04), phase=(0.1, 0.0, 0.2),
                       periods=(periods, periods, periods))
        assert insides(answer, hidden) == inside


def test_no_sizes_of_a_name_that_is_wrong():
    assert sizes_of(found("backlash", increase=(1.0, 0.0, 2.0)), unit("hall_misalignment")) == []


@pytest.mark.parametrize("name", DAMAGES)
def test_damages_of_the_second_simulator_are_laws_of_the_catalogue(name):
    a = load_actuator()
    truth = catalogued(a, name, Damage(phase=1, angle=0.3))
    parse_effects([f"{key}={value}" for key, value in truth.items()])
    assert as_written(truth, name).keys() >= truth.keys()


def row(named, verdict="explained", names=("backlash",), **more):
    return {"names": names, "strange": False, "verdict": verdict, "named": named,
            "seconds": 1.0, "wall": 2.0, "next": None, "sizes": [], **more}


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


def test_one_more_test_of_a_unit_is_of_the_same_unit_on_another_day():
    tests = ("step",)
    for stratum in ("own, one effect", "second, one effect", "pwm, second, one effect"):
        made, again = (STRATA[stratum](3, 1, tests) for _ in range(2))
        profile = load_profile("step") if made.kit is None else made.records[0].profile
        more = made.again(profile)
        assert np.array_equal(made.records[0].samples, again.records[0].samples)
        assert np.array_equal(more.samples, again.again(profile).samples)
        assert not np.array_equal(more.samples, made.records[0].samples)
        assert more.provenance.serial_number == made.records[0].provenance.serial_number


def test_two_damages_of_the_second_simulator_are_of_two_families():
    for k in range(6):
        unit = STRATA["second, two effects"](3, k, ("step",))
        assert len(set(unit.names)) == 2 and set(unit.names) <= set(DAMAGES)
        assert not any(set(unit.names) <= family for family in HARD_TO_TELL)
        assert {key.partition(".")[0] for key in unit.truth} == set(unit.names)


def test_with_several_pole_pairs_an_angle_is_the_same_from_each_turn_on():
    of = SimpleNamespace(kit=PWM)  # five of them
    turn = 2.0 * np.pi / 5.0
    assert turn_of(of, "rotor_eccentricity", {}) == pytest.approx(turn)
    cogging, mesh = {"cogging_torque.periods": 30.0}, {"gear_mesh_ripple.periods": 17.0}
    assert turn_of(of, "cogging_torque", cogging) == pytest.approx(5.0 * turn)
    assert turn_of(of, "gear_mesh_ripple", mesh) == pytest.approx(turn)
    assert turn_of(of, "hall_misalignment", {}) == pytest.approx(2.0 * np.pi)


def test_units_are_judged_two_at_a_time_and_none_twice(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    counts = {"own, nothing": 2, "own, unlisted off, nothing": 1}
    path, seed, tests = tmp_path / "decisions.jsonl", 20263201, ("step",)
    run(tmp_path, Ledger(path), seed, counts, tests, 2)
    rows = Ledger(path)
    assert sorted(rows.keys) == sorted(key for key, *_ in units_of(seed, counts, "step"))
    assert {rows.run(key, dict)["verdict"] for key in rows.keys} == {"no disagreement"}
    kept = path.read_bytes()
    capsys.readouterr()
    run(tmp_path, Ledger(path), seed, counts, tests, 2)
    assert path.read_bytes() == kept and capsys.readouterr().out == ""


@pytest.mark.slow
def test_an_effect_that_a_unit_beyond_its_bands_nearly_explains_is_named(tmp_path, monkeypatch):
    """Hall sensors 0.1 rad off, of the second simulator: the evidence decides (section 4)."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    tests = ("extended", "step")
    row = answered(STRATA["second, one effect"](20263341, 3, tests), tmp_path)
    assert (row["names"], outcome(row)) == (("hall_misalignment",), "right")


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "k", "what"), [
    (20263461, 21, "gear_mesh_ripple"),  # at an order without a signature, all else usual
    (20263471, 2, "load_dependent_friction"),  # another load on the day of the held-out record
    (20263371, 7, "surface_load"),  # the surface turns the motor, on the held-out day it does not
])
def test_what_earlier_panels_missed_is_named(tmp_path, monkeypatch, seed, k, what):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    row = answered(STRATA["own, one effect"](seed, k, ("extended", "step")), tmp_path)
    assert (row["names"], outcome(row), row["verdict"]) == ((what,), "right", "explained")


@pytest.mark.slow
def test_what_is_hidden_is_visible_beside_all_that_a_unit_may_be(tmp_path, monkeypatch):
    """Apart from the workflow; nothing hidden leaves nothing, whatever the noise."""
    monkeypatch.setattr(visible, "UNITS", 200)  # the regression has 130 numbers
    floor, tests = visible.make_floor(tmp_path / "floor.npz", "step"), ("step",)
    nothing = STRATA["own, unlisted off, nothing"](1, 0, tests)
    assert visible.gap_of(nothing, floor)[0] == 0.0
    for stratum in ("own, one effect", "second, one effect"):
        unit = STRATA[stratum](3, 0, tests)
        gap, block = visible.gap_of(unit, floor)
        assert gap > visible.THRESHOLD, (unit.names, block)
