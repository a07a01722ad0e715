"""Current sensors, torque lines, segments, matched filter: closed forms."""

import numpy as np
import pytest

from ema_prognostics.current_sensors import current_sensors
from ema_prognostics.line_inputs import LineStatistics, matched_short
from ema_prognostics.segments import profile_kind
from ema_prognostics.torque_lines import Plant, torque_current, torque_lines, trapezoid
from ema_prognostics.turns import whole_turns
from ema_record.profile import load_profile, load_profile_dict, step_profile
from records import TURN, slewing_record

PLANT = Plant(
    back_emf_constant=0.0376, flat_top=TURN / 3, torque_limit=1.6, motor_inertia=1.5e-5,
    gear_ratio=500.0, surface_inertia=0.2, surface_viscous_friction=2.0, shaft_stiffness=1e5,
    shaft_damping=30.0,
)


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
        trapezoid(theta, TURN / 3), [0, 0.5, 1, 1, 1, 0.5, 0, -1, -1, -0.5], atol=1e-12
    )


def test_torque_current_is_the_amplitude_when_two_phases_carry():
    record = slewing_record(current=6.0)
    q = torque_current(record.samples[:, 8], record.samples[:, 5:8], TURN / 3)
    np.testing.assert_allclose(q, 6.0, atol=1e-9)


@pytest.mark.parametrize("direction", [1, -1])
def test_residual_of_a_current_line_at_constant_speed(direction):
    record = slewing_record(current_lines=[(2, 0.35, 0.4)], direction=direction)
    turns = whole_turns(record, (0.082, 0.382))
    found = torque_lines(turns, turns.samples[:, 5:8], PLANT)
    assert found.mean_current == pytest.approx(7.0, rel=1e-3)
    assert found.residual[1] == pytest.approx(-0.05 * np.exp(0.4j), abs=2e-4)
    assert abs(found.residual[[0, 2, 3, 4]]).max() < 1e-3


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_matched_filter_names_the_phase(phase):
    statistics = LineStatistics(
        baseline=np.zeros((1, 6), complex), weight=np.ones((1, 6)), deviation=np.full(6, 1e-3)
    )
    lines = np.zeros((1, 6), complex)
    for h, size in ((2, 0.278), (4, 0.132)):
        lines[0, h - 1] = 0.1 * size * np.exp(-1j * h * phase * TURN / 3)
    found, fraction = matched_short(lines, statistics)
    assert found[0] == phase
    assert fraction[0] == pytest.approx(0.1)


def test_kind_of_test_is_read_off_the_points_and_not_the_name():
    assert profile_kind(load_profile("step")) == "step"
    extended = load_profile("extended").model_dump()
    assert profile_kind(load_profile_dict({**extended, "name": "x"}, "x")) == "extended"
    assert profile_kind(step_profile(0.8, start=-0.4)) == "step"
    assert profile_kind(step_profile(-0.7, start=0.4)) == "step"
    assert profile_kind(step_profile(0.2)) is None
    back = {"name": "x", "points": [(0, 0), (0.02, 0), (0.02, 0.6), (0.1, 0.6), (0.1, 0), (1, 0)]}
    assert profile_kind(load_profile_dict(back, "x")) is None
