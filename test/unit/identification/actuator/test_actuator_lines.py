"""The clearest line that is left, and the port that lines and sensors point to."""

from types import SimpleNamespace

import numpy as np
import pytest

from ema_identification.actuator.decision import proposals
from ema_identification.actuator.decision.proposals import MOST_OFF, ripple_power, ripples
from ema_identification.actuator.measure.control_law import ControlLaw
from ema_identification.actuator.measure.features import Feature
from ema_identification.actuator.measure.segments import MotionSegment, Transition
from ema_identification.actuator.ports import _turns_with_direction, largest_line, unknown_shape

SPEEDS = (25.0, -25.0, 200.0, -200.0)
DEVIATION = 0.5


def unit_of(orders, extra=()):
    """Return a unit whose features are torque lines, in mA, and `extra` others."""
    segments = [MotionSegment(name=f"s{k}", kind="ramp", begin=k, end=k + 1.0, speed=v)
                for k, v in enumerate(SPEEDS)]
    features = [
        Feature(f"{s.name}.torque_line_{n}_{part}", s.name, "motor torque", "rotor angle")
        for s in segments for n in orders for part in ("re", "im")]
    features += extra
    repeat = SimpleNamespace(deviation=lambda _noise: np.full(len(features), DEVIATION))
    jumps = [Transition(name=f"t{k}", kind="start", time=k, room=0.1, before=0.0, after=v,
                        stepped=True) for k, v in enumerate((800.0, 25.0))]
    plan = SimpleNamespace(segments=segments, transitions=jumps)
    fmap = SimpleNamespace(features=tuple(features), plan=plan)
    library = SimpleNamespace(repeat=repeat, fmap=fmap, model=SimpleNamespace(
        actuator=SimpleNamespace(control=SimpleNamespace(speed_limit=790.6))))
    unit = SimpleNamespace(library=library,
                           conditions=SimpleNamespace(noise=1.0), split=lambda values: [values])
    unit.parts = (unit,)
    return unit


def line_of(unit, values):
    """Return the clearest line."""
    return largest_line(unit.library.fmap, values, unit.library.repeat.deviation(1.0))


def residual(lines):
    """Return residuals in standard deviations of complex lines, shape (segments, orders)."""
    return np.stack([np.real(lines), np.imag(lines)], axis=-1).ravel() / DEVIATION


LINE = 10.0 * np.exp(0.7j)
QUIET = np.zeros(4)
HOLDS = ControlLaw(holds=True, text="as in the model")


@pytest.mark.parametrize("sense", [np.ones(4), np.sign(SPEEDS)])
def test_a_ripple_has_one_phase_in_all_sections_or_turns_over_with_the_direction(sense):
    found = line_of(unit_of((5, 9)), residual(np.stack([QUIET, sense * LINE], axis=1)))
    assert found is not None
    assert found[0] == 9
    assert found[1] == pytest.approx(2e-3 * abs(LINE))


def test_a_limit_cycle_in_one_section_or_without_a_common_phase_is_no_ripple():
    phases = np.exp(1j * np.array([0.0, 2.0, 4.0, 5.0]))
    for lines in (phases * LINE, np.array([3.0 * LINE, 0.0, 0.0, 0.0])):
        assert line_of(unit_of((5, 9)), residual(np.stack([QUIET, lines], axis=1))) is None


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_ripple_clear_at_one_speed_counts_where_limit_cycles_hide_it_at_another(sense):
    locked = np.exp(1j * np.array([0.0, 2.0])) * LINE
    lines = np.concatenate([locked, np.array([1.0, sense]) * 2.0 * LINE])
    found = line_of(unit_of((5, 9)), residual(np.stack([QUIET, lines], axis=1)))
    assert found is not None
    assert found[0] == 9
    assert found[1] == pytest.approx(2e-3 * 2.0 * abs(LINE))


@pytest.mark.parametrize("sense", [np.ones(4), np.sign(SPEEDS)])
def test_a_ripple_may_be_smaller_where_the_shaft_holds_the_rotor(sense):
    lines = sense * np.array([0.1, 0.4, 1.0, 0.9]) * LINE
    found = line_of(unit_of((5, 9)), residual(np.stack([QUIET, lines], axis=1)))
    assert found is not None
    assert found[0] == 9
    assert found[1] == pytest.approx(2e-3 * abs(LINE), rel=0.1)


def test_the_strongest_ripple_counts_even_if_a_weak_one_is_in_all_sections():
    weak, strong = np.full(4, LINE), 5.0 * np.exp(1j * np.array([2.0, 4.0, 0.0, 0.0])) * LINE
    found = line_of(unit_of((5, 9)), residual(np.stack([weak, strong], axis=1)))
    assert found is not None
    assert found[0] == 9


def test_a_ripple_wins_over_a_larger_limit_cycle():
    cycle = np.array([5.0 * LINE, 0.0, 0.0, 0.0])
    found = line_of(unit_of((5, 9)), residual(np.stack([cycle, np.full(4, LINE)], axis=1)))
    assert found is not None
    assert found[0] == 9


def port_of(lines, gain):
    unit = unit_of((6, 24), [
        Feature("gain_ab", "record", "sum of the phase currents", "load"),
        Feature("s0.error", "s0", "motor speed", "frequency")])
    return unknown_shape(unit, np.append(residual(lines), [gain, 5.0])).port


def test_a_sensor_is_given_only_where_its_own_features_lead():
    lines = np.stack([np.full(4, LINE) * np.sign(SPEEDS), QUIET], axis=1)
    assert port_of(lines, 60.0).startswith("sensor")
    assert not port_of(20.0 * lines, 60.0).startswith("sensor")


@pytest.mark.parametrize(("line", "turned"), [
    (12j * np.sign(SPEEDS), True),  # late forward is early back
    (12j * np.ones(4), False),  # of the angle alone, as cogging
    (12.0 * np.ones(4), False), (12.0 * np.sign(SPEEDS), False)])  # windings, whatever their shape
def test_quadratures_that_turn_with_the_direction_are_the_commutation(line, turned):
    assert ("commutation" in port_of(np.stack([line, QUIET], axis=1), 0.0)) is turned


def test_sections_follow_one_another_as_in_the_test():
    """There may be more than ten, and by name the tenth follows the first."""
    values = {f"s{k}.torque_line_6_re": 5.0 * (-1) ** k for k in range(1, 14)}
    assert _turns_with_direction(values) == 12 * 25.0


@pytest.mark.parametrize(("sense", "given"), [(np.ones(4), True), (np.sign(SPEEDS), False)])
def test_a_ripple_of_the_commutations_order_is_a_torque_of_its_own_if_it_keeps_its_sign(
        sense, given):
    lines = np.stack([12.0 * sense, QUIET], axis=1)
    assert ("motor torque" in port_of(lines, 0.0)) is given


def test_a_ripple_is_not_given_where_something_else_is_far_larger():
    def port(largest):
        unit = unit_of((5, 9), [
            Feature(f"t0.speed_{k}", "t0", "motor speed", "test phase") for k in range(9)])
        lines = residual(np.stack([QUIET, np.full(4, 2.0 * LINE)], axis=1))
        return unknown_shape(unit, np.append(lines, np.full(9, largest)), HOLDS).port

    assert port(5.0) == "motor torque, transmission"
    assert port(5000.0).startswith("winding")


@pytest.mark.parametrize(("place", "holds", "port"), [
    ("t0", True, "winding"), ("t1", True, "friction"), ("t0", False, "controller")])
def test_a_speed_that_runs_otherwise_is_what_makes_it_run(place, holds, port):
    """At a long current limit the windings, at a short one friction, the control if it is off."""
    unit = unit_of((5, 9), [
        Feature(f"{place}.speed_{k}", place, "motor speed", "test phase") for k in range(5)])
    rest = np.append(np.zeros(len(unit.library.fmap.features) - 5), np.full(5, 7.0))
    law = HOLDS if holds else HOLDS._replace(holds=False)
    assert unknown_shape(unit, rest, law).port.split(", ")[0] == port


def test_the_power_of_a_ripple_is_the_mean_of_its_lines_by_periods_of_the_rotors_turn():
    """With three pole pairs line 4 of the windings comes twelve times a turn of the rotor."""
    extra = [Feature(f"s0.turn_torque_line_{n}_{part}", "s0", "motor torque", "rotor angle")
             for n in (2, 12) for part in ("re", "im")]
    unit = unit_of((1, 4), extra)
    unit.library.model = SimpleNamespace(actuator=SimpleNamespace(
        motor=SimpleNamespace(pole_pairs=3)))
    rest = np.zeros(len(unit.library.fmap.features))
    assert ripple_power(unit, rest) == {12: 0.0}  # 1 and 2 are the windings'
    rest[[n.name.endswith("line_1_re") for n in unit.library.fmap.features]] = 9.0
    rest[-1] = 3.0
    assert ripple_power(unit, rest) == {12: pytest.approx(9.0 / 10.0)}
    rest[-1] = 1e6
    assert ripple_power(unit, rest) == {12: pytest.approx(MOST_OFF**2 / 10.0)}


def test_a_ripple_is_looked_for_where_runs_and_library_both_are_off(monkeypatch):
    """A few runs that ring at an order of their own do not hide the one that the record has."""
    unit, asked = unit_of((13, 16)), []
    record, ringing = residual(np.array([0.2 * LINE, 0.0]) * np.ones((4, 1))), residual(
        np.array([0.0, 0.4 * LINE]) * np.ones((4, 1)))
    white = SimpleNamespace(deviation=np.ones(len(record)))
    unit.library.model.actuator = SimpleNamespace(
        motor=SimpleNamespace(pole_pairs=1, dynamic_friction=1.0),
        surface=SimpleNamespace(dynamic_friction=1.0), shaft=SimpleNamespace(stiffness=1.0))
    unit.size, unit.values = len(record), record
    unit.known = lambda terms, z: np.zeros(len(record))
    unit.whitener = lambda runs: white
    unit.run_all = lambda models, *_: [np.full(len(record), np.nan)] * len(models)
    real = proposals.ripple
    monkeypatch.setattr(proposals, "ripple", lambda effect, periods, *levels: (
        asked.append(periods) or real(effect, periods, *levels)))
    assert ripples(unit, SimpleNamespace(mean=-ringing, terms=(), z=QUIET), white, ()) == []
    assert asked == [13, 13]
