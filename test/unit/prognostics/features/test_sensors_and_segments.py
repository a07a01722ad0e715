"""Current sensors, torque lines, segments, matched filter: closed forms."""

import numpy as np
import pytest

from ema_prognostics.features.balance import torque_balance
from ema_prognostics.features.profile_kind import profile_kind
from ema_prognostics.features.signals import current_sensors, prepare
from ema_record.profile import load_profile, load_profile_dict, step_profile
from ema_sim.machine import unit_trapezoid
from ema_sim.plant.electrical import trapezoid
from support.simulations import TURN, slewing_record


def test_offsets_and_gains_of_the_current_sensors():
    record = slewing_record(noise=0.05)
    offset, gain = np.array([0.05, -0.03, 0.02]), np.array([1.01, 0.995, 0.995])
    record.samples[:, 2:5] = record.samples[:, 2:5] * gain + offset
    found = current_sensors(record)
    np.testing.assert_allclose(found.offset, offset, atol=0.01)
    np.testing.assert_allclose(found.gain, gain / gain.mean(), atol=1e-3)
    corrected = found.correct(record.samples[:, 2:5])
    assert abs(corrected.sum(axis=1).mean()) < 0.01


def test_trapezoid_is_flat_over_a_third_of_a_turn():
    theta = np.deg2rad([0, 15, 30, 90, 150, 165, 180, 210, 270, 345])
    np.testing.assert_allclose(
        unit_trapezoid(theta, TURN / 3), [0, 0.5, 1, 1, 1, 0.5, 0, -1, -1, -0.5], atol=1e-12
    )


@pytest.mark.parametrize("top", [0.5, TURN / 3, 2.9])
def test_the_trapezoid_of_arrays_is_that_of_the_kernel(top):
    theta = np.linspace(0.0, TURN, 4001)[:-1]
    np.testing.assert_allclose(
        unit_trapezoid(theta, top), [trapezoid(t, top) for t in theta], atol=1e-12)


def test_torque_current_is_the_amplitude_when_two_phases_carry():
    q = prepare(slewing_record(current=6.0)).torque_current
    np.testing.assert_allclose(q[1000:], 6.0, atol=1e-2)


@pytest.mark.parametrize("direction", [1, -1])
def test_residual_of_a_current_line_at_constant_speed(direction):
    record = slewing_record(current_lines=[(2, 0.35, 0.4)], direction=direction)
    found = torque_balance(prepare(record), 0.1, 0.36, 20)
    assert found.torque == pytest.approx(2 * 0.0376 * 7.0, rel=2e-3)
    assert found.residual[1] == pytest.approx(-0.05 * np.exp(0.4j), abs=1e-3)
    assert abs(found.residual[[0, 2, 3, 4]]).max() < 2e-3


def test_kind_of_test_is_read_off_the_points_and_not_the_name():
    assert profile_kind(load_profile("step")) == "step"
    extended = load_profile("extended").model_dump()
    assert profile_kind(load_profile_dict({**extended, "name": "x"}, "x")) == "extended"
    assert profile_kind(step_profile(0.8, start=-0.4)) == "step"
    assert profile_kind(step_profile(-0.7, start=0.4)) == "step"
    assert profile_kind(step_profile(0.2)) is None
    back = {"name": "x", "points": [(0, 0), (0.02, 0), (0.02, 0.6), (0.1, 0.6), (0.1, 0), (1, 0)]}
    assert profile_kind(load_profile_dict(back, "x")) is None
