"""Clocks and lags: a filtered speed, a lag of the drive, waves in time, runs of one motion."""

import numpy as np
import pytest
from scipy import signal

from ema_identification.rig.fit.balance import Design
from ema_identification.rig.fit.model import Settings
from ema_identification.rig.laws import LAWS
from ema_identification.rig.laws.base import Term
from ema_identification.rig.prepare import prepare
from ema_identification.rig.search.shapes import cycle_frequency, smooth_shapes
from ema_identification.rig.signals.clocks import speed_lag
from ema_identification.rig.signals.trajectory import derivative
from ema_identification.rig.workflow import identify_rig
from ema_rig.record import Axis


def named(found):
    return [finding.effect for finding in found.findings]


@pytest.mark.parametrize("late", [0.0, 0.006])
def test_the_lag_of_a_speed_is_found_where_there_is_one(late, moving):
    t, q, v, _ = moving()
    delayed = np.interp(t - late, t, v) + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    piece = {"time": t, "position": q, "speed": delayed, "rate": np.array(1.0 / t[1])}
    assert speed_lag([piece], 20.0, 2.0) == pytest.approx(late, abs=1e-4)


@pytest.mark.slow
def test_a_filtered_speed_is_put_on_the_clock_of_the_position(axis, moving, recorded):
    t, q, v, a = moving()
    slow = signal.lfilter(*signal.bessel(2, 12.0, fs=1.0 / t[1]), v)
    ripple = 0.3 * np.cos(8 * q - 0.5)
    record = recorded(t, 0.05 * a + 0.4 * v + 0.5 * np.sign(v) + ripple, axis, position=q,
                      speed=slow)
    found = identify_rig([record])
    assert sorted(named(found)) == ["cogging_torque", "coulomb_friction"]
    assert any("ms earlier, where it is the slope of the position" in r for r in found.reasons)


def test_the_shape_against_speed_holds_no_filter(bench):
    """Whatever its knots, its straight line is the speed itself, not the smooth speed."""
    trajectory = prepare([bench(keep=("speed",))], Settings())
    shape = smooth_shapes(trajectory)[0]
    speed = trajectory.reduce(lambda segment: segment.speed)
    found, *_ = np.linalg.lstsq(shape.columns, speed, rcond=None)
    np.testing.assert_allclose(shape.columns @ found, speed, atol=1e-8 * np.abs(speed).max())


@pytest.mark.slow
def test_a_first_order_lag_is_told_from_a_delay(moving, recorded):
    t, q, v, a = moving(duration=10.0)
    axis = Axis(name="motor", motion="rotary", input="voltage")
    torque = 0.05 * a + 0.4 * v
    late = recorded(t, torque + 0.1 * derivative(torque, t[1]), axis, noise=0.005, position=q)
    found = identify_rig([late])
    assert [{f.effect, *f.equivalent} for f in found.findings] == [
        {"drive_lag", "winding_inductance"}]
    assert found.findings[0].parameters[0].value == pytest.approx(0.1, rel=0.02)
    assert "the axis held: the inductance shows in the current" in found.next_test


def test_the_laws_of_two_masses_and_of_a_crank_follow_their_equations(bench):
    trajectory = prepare([bench()], Settings())
    design = Design(trajectory)
    assert cycle_frequency(trajectory) is None
    crank = design.columns(Term(law=LAWS["position_dependent_inertia"], shape=(2.0,)))
    expected = trajectory.reduce(lambda s: np.cos(2 * s.position) * s.acceleration
                                 - np.sin(2 * s.position) * s.speed**2)
    np.testing.assert_allclose(crank[:, 0], expected)
    above = design.columns(Term(law=LAWS["load_side_compliance"]))[:, 0]
    curve = trajectory.reduce(lambda s: derivative(derivative(s.acceleration, s.step), s.step))
    np.testing.assert_allclose(above, curve)


@pytest.mark.slow
def test_a_crank_is_named_with_its_order(bench):
    found = identify_rig([bench(
        lambda t, q, v, a: 0.02 * (np.cos(2 * q) * a - np.sin(2 * q) * v**2), duration=10.0)])
    assert named(found) == ["position_dependent_inertia"]
    values = {p.name.split(".")[1]: p.value for p in found.findings[0].parameters}
    assert values["amplitude"] == pytest.approx(0.02, rel=0.02)
    assert values["order"] == 2.0


@pytest.mark.slow
def test_a_wave_in_time_is_named_and_stays_named_in_another_record(bench, tmp_path):
    def hum(phase):
        return lambda t, q, v, a: 0.5 * np.sin(2 * np.pi * 11.3 * t + phase)

    found = identify_rig([bench(hum(0.3), duration=10.0, seed=1)],
                         validate=[bench(hum(2.0), duration=10.0, seed=2)])
    assert named(found) == ["periodic_disturbance"]
    assert found.gap_after < 0.2 * found.gap_before
    path = tmp_path / "model.yaml"
    path.write_text(found.model_text, encoding="utf-8")
    again = identify_rig([bench(hum(-1.0), duration=10.0, seed=3)], path)
    assert again.verdict == "no disagreement"


def test_a_motion_that_repeats_itself_tells_its_cycle(axis, recorded):
    t = np.arange(6000) / 250.0
    q = np.sin(2 * np.pi * 0.7 * t) + 0.2 * np.sin(2 * np.pi * 1.4 * t)
    record = recorded(t, derivative(q, t[1]), axis, position=q)
    assert cycle_frequency(prepare([record], Settings())) == pytest.approx(0.7, rel=1e-3)
