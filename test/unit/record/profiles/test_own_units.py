"""Profiles in the actuator's own units and by moves; their text; files of the default tests."""

import math

import pytest
import yaml

from ema_record.actuator import load_actuator
from ema_record.errors import UsageError
from ema_record.kit import shipped_kit, using_kit
from ema_record.profile import load_profile, load_profile_dict, step_profile
from ema_record.profiles.design import default_profiles
from ema_record.profiles.text import moves, profile_yaml, write_profiles


def made(points, **units):
    data = {"name": "own", "points": points}
    return load_profile_dict({**data, "units": units} if units else data, "own.yaml")


def test_moves_are_the_points_that_they_mean():
    actuator = load_actuator()
    stop, slew = actuator.surface.end_stop, actuator.slew_speed
    found = made([[0.0, -0.5], {"hold": 0.022}, {"to": 0.5}, {"hold": 0.578},
                  {"to": 0.0, "speed": 0.25}, [2.0, 0.25]], position="stroke", speed="slew")
    slope = 0.5 * stop / (0.25 * slew)
    expected = [(0.0, -0.5 * stop), (0.022, -0.5 * stop), (0.022, 0.5 * stop), (0.6, 0.5 * stop),
                (0.6 + slope, 0.0), (2.0, 0.25 * stop)]
    assert [t for t, _ in found.points] == pytest.approx([t for t, _ in expected])
    assert [x for _, x in found.points] == pytest.approx([x for _, x in expected])


def test_turns_of_the_rotor():
    turn = 2.0 * math.pi / load_actuator().gear.ratio
    found = made([[0.0, -10.0], [0.1, 10.0]], position="turns")
    assert [x for _, x in found.points] == pytest.approx([-10.0 * turn, 10.0 * turn])


def test_moves_in_rad_need_no_units():
    found = made([[0.0, 0.1], {"to": 0.3, "speed": 0.4}])
    assert found.points == ((0.0, 0.1), (0.5, 0.3))


@pytest.mark.parametrize(("points", "units", "message"), [
    ([[0.0, 0.0], {"to": 0.5, "speed": 0.0}], {}, "points.1.speed: 0.0 must be above 0"),
    ([[0.0, 0.0], {"go": 0.5}], {}, "points.1: a move is"),
    ([{"hold": 1.0}], {}, "points.0: the first point is"),
    ([[0.0, 0.0], {"hold": "long"}], {}, "'long' is not a number"),
    ([[0.0, 0.0], {"hold": True}], {}, "'True' is not a number"),
    ([[0.0, 0.0], {"hold": float("nan")}], {}, "'nan' is not a number"),
    ([[0.0, 0.0], {"hold": -1.0}], {}, "greater than or equal to 0"),
    ([[0.0, 0.0], {"hold": 10**400}], {}, "is not a number"),
    ([[0.0, 0.0, 0.0], {"hold": 1}], {}, r"expected \[time, position\] or a move"),
    ([[0.0, 0.0], [1.0, 1.0]], {"position": "deg"}, "unknown unit in own.yaml 'deg': one of rad"),
    ([[0.0, 0.0], [1.0, 1.0]], {"time": "s"}, "unknown unit of own.yaml 'time'"),
    ([[0.0, 0.0], [1.0, 1.0]], {"position": ["rad"]}, "unknown unit"),
    ("all", {"position": "rad"}, "not a number|expected"),
    (None, {"position": "rad"}, "expected a list"),
    ([[0.0, 0.0], [99.0, 0.1]], {"position": "stroke"}, "less than or equal to 60"),
])
def test_bad_own_units_are_one_line(points, units, message):
    with pytest.raises(UsageError, match=message) as caught:
        made(points, **units)
    assert "\n" not in str(caught.value)


def test_a_step_of_another_size_is_like_the_step_of_the_kit(tmp_path):
    assert step_profile(0.8).points == load_profile("step").points
    assert step_profile(0.8).window == load_profile("step").window
    assert step_profile(0.1, duration=0.2).window is None
    actuator = load_actuator()
    far = actuator._replace(surface=actuator.surface._replace(end_stop=0.2))
    write_profiles(far, tmp_path / "profiles")
    text = (shipped_kit() / "actuator.yaml").read_text(encoding="utf-8")
    (tmp_path / "actuator.yaml").write_text(text.replace("end_stop: 0.6", "end_stop: 0.2"),
                                            encoding="utf-8")
    with using_kit(tmp_path):
        assert step_profile(0.1).start == load_profile("step").start == -0.18


def test_a_profile_as_moves_of_an_actuator():
    actuator = load_actuator()
    found = moves(load_profile("extended"), actuator)
    assert [m.kind for m in found[:4]] == ["start", "hold", "step", "hold"]
    step = found[2]
    assert step.turns == pytest.approx(0.8 * actuator.gear.ratio / (2.0 * math.pi))
    assert step.speed is None
    assert (step.stroke, step.left) == pytest.approx((2.0 / 3.0, 0.2))
    quarter = next(m for m in found if m.kind == "slew")
    assert quarter.slew == pytest.approx(0.25, abs=1e-3)


def test_files_of_the_default_tests_read_back(tmp_path):
    actuator = load_actuator()
    for path in write_profiles(actuator, tmp_path / "profiles"):
        assert load_profile(path) == default_profiles(actuator)[path.stem]
    text = profile_yaml(load_profile("ramps"), actuator, "a test")
    assert load_profile_dict(yaml.safe_load(text), "ramps") == load_profile("ramps")
