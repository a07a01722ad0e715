"""Waves that are the axis' own, springs that harden, stops: closed forms, and what is no wave."""

import numpy as np
import pytest

from ema_identification.rig.export import LAW_TEXTS
from ema_identification.rig.fit.balance import Design, InputBalance
from ema_identification.rig.fit.model import Settings
from ema_identification.rig.fit.regression import CoefficientBounds
from ema_identification.rig.laws import LAWS
from ema_identification.rig.laws.base import Term
from ema_identification.rig.laws.static import END_STOP, END_STOPS, HARDENING_SPRING, orders
from ema_identification.rig.prepare import prepare
from ema_identification.rig.search.waves import wave_stands
from ema_identification.rig.workflow import identify_rig
from ema_record.errors import UsageError
from ema_rig.map import map_from
from ema_rig.record import Axis


def balance_of(record, *terms):
    trajectory = prepare([record], Settings())
    count = sum(len(term.law.coefficients) for term in terms)
    return InputBalance(design=Design(trajectory), terms=terms, bounds=CoefficientBounds(
        low=np.full(count, -np.inf), high=np.full(count, np.inf)))


BASE = tuple(Term(law=LAWS[n]) for n in ("inertia", "viscous_friction", "coulomb_friction"))


def of_waves(record, order):
    return balance_of(record, *BASE, Term(law=LAWS["cogging_torque"], shape=(order,)))


def test_no_order_has_fewer_than_three_periods_in_the_travel(bench):
    trajectory = prepare([bench()], Settings())
    assert min(order for order, in orders(trajectory)) * trajectory.turns >= 3.0


def test_a_wave_of_the_axis_stands(bench):
    record = bench(lambda t, q, v, a: 0.3 * np.sign(v) + 0.1 * np.cos(9 * q))
    assert wave_stands(of_waves(record, 9.0), 3)


def test_a_slower_wave_that_does_better_takes_its_place_away(bench):
    record = bench(lambda t, q, v, a: 0.2 * np.cos(4 * q))  # 1.8 periods in the travel
    assert not wave_stands(of_waves(record, 7.0), 3)


def test_what_only_reversals_show_is_no_wave(axis, recorded):
    """Always the same two places of reversal, each with an error of its friction."""
    t = np.arange(8000) / 400.0
    q, w = np.sin(2 * np.pi * 0.5 * t), 2 * np.pi * 0.5
    v, a = w * np.cos(w * t), -(w**2) * np.sin(w * t)
    near = np.exp(-((v / (0.08 * w)) ** 2))
    for extra, stands in ((0.3 * near * np.cos(20 * q), False), (0.3 * np.cos(20 * q), True)):
        u = 0.05 * a + 0.4 * v + 0.3 * np.sign(v) + extra
        balance = balance_of(recorded(t, u, axis, position=q), *BASE,
                             Term(law=LAWS["cogging_torque"], shape=(20.0,)))
        assert wave_stands(balance, 3) is stands


@pytest.mark.parametrize(("law", "extra", "name"), [
    (HARDENING_SPRING, lambda q: 0.5 * q**3, "hardening_spring"),
    (END_STOPS, lambda q: 3.0 * (q - np.clip(q, -0.7, 0.7)), "end_stops"),
    (END_STOP, lambda q: 3.0 * np.maximum(q - 0.5, 0.0), "end_stop"),
])
def test_what_holds_the_axis_is_named_with_its_stiffness(bench, law, extra, name):
    found = identify_rig([bench(lambda t, q, v, a: extra(q), duration=12.0)])
    (finding,) = found.findings
    assert name in (finding.effect, *finding.equivalent)
    assert found.gap_after < 0.3 * found.gap_before
    if finding.effect == name:
        own = {p.name.partition(".")[2]: p for p in finding.parameters
               if p.name.startswith(f"{name}.")}
        truth = {"hardening_spring": ("cubic", 0.5), "end_stops": ("stiffness", 3.0),
                 "end_stop": ("stiffness", 3.0)}[name]
        assert own[truth[0]].value == pytest.approx(truth[1], rel=0.1)


def test_the_module_of_a_spring_and_stops_is_their_law():
    x = 0.9
    text = LAW_TEXTS["end_stops"].format(stiffness=3.0, middle=0.1, half_clearance=0.5)
    assert eval(text, {"x": x}) == pytest.approx(3.0 * (0.9 - 0.1 - 0.5))
    assert eval(text, {"x": 0.2}) == pytest.approx(0.0)
    text = LAW_TEXTS["hardening_spring"].format(cubic=2.0, rest=0.4)
    assert eval(text, {"x": x}) == pytest.approx(2.0 * 0.5**3)


def test_once_and_twice_the_pole_pairs_a_current_sensor_looks_like_cogging():
    law = LAWS["cogging_torque"]
    motor = Axis(name="m", motion="rotary", input="current", pole_pairs=7)
    assert law.equivalent(motor, (7.0,)) == ("current_sensor_offset",)
    assert law.equivalent(motor, (14.0,)) == ("current_sensor_gain",)
    assert law.equivalent(motor, (12.0,)) == ()
    unknown = Axis(name="m", motion="rotary", input="current")
    assert law.equivalent(unknown, (7.0,)) == ()


@pytest.mark.parametrize(("axis_of", "pairs", "says"), [
    ("linear", 7, "rotary axis"), ("rotary", 0, "pole_pairs"), ("rotary", "seven", "pole_pairs")])
def test_wrong_pole_pairs_are_one_line(axis_of, pairs, says):
    data = {"name": "m", "axis": axis_of, "time": {"column": "t"}, "pole_pairs": pairs,
            "input": {"column": "i", "unit": "A"}, "position": {"column": "q", "unit": "rad"}}
    with pytest.raises(UsageError, match=says) as caught:
        map_from(data, "map.yaml")
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_pendulum_about_its_rest_is_no_spring_that_softens(bench):
    """A sine is a line less a cube, until it swings far: one law in place of two."""
    found = identify_rig([bench(lambda t, q, v, a: 1.5 * np.sin(q), duration=32.0)])
    assert [finding.effect for finding in found.findings] == ["gravity"]
