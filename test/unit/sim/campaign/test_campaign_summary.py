import numpy as np
import pytest

from ema_record.channels import MOTOR_SPEED, REFERENCE_CURRENTS, ROTOR_ANGLE
from ema_record.errors import UsageError
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_sim.campaign.reductions import SUMMARY_UNITS, as_columns, summary

RATE, SPEED = 20_000.0, 790.6


def record(direction=1.0):
    samples = np.zeros((9000, 10))
    samples[:, 0] = (np.arange(9000) + 0.5) / RATE
    angle = direction * SPEED * samples[:, 0] + 0.3
    samples[:, ROTOR_ANGLE] = np.mod(angle, 2 * np.pi)
    samples[:, MOTOR_SPEED] = SPEED + 0.5 * np.cos(2 * angle + 1.0) + 0.2 * np.sin(6 * angle)
    samples[:, 2:5] = [5.0, -5.0, 0.0]
    samples[:, REFERENCE_CURRENTS] = [4.9, -4.9, 0.0]
    return Record(samples=samples, profile=load_profile("step"))


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_means_and_lines_of_a_known_record(direction):
    found = summary(record(direction))
    assert found["electrical_frequency"] == pytest.approx(SPEED / (2 * np.pi), rel=2e-3)
    assert found["speed_mean"] == pytest.approx(SPEED, abs=0.01)
    assert found["speed_line_2"] == pytest.approx(0.5, rel=0.01)
    assert found["speed_line_6"] == pytest.approx(0.2, rel=0.01)
    assert found["speed_line_1"] < 0.005 > found["speed_line_3"]
    assert found["torque_current_mean"] == pytest.approx(5.0)
    assert found["current_rms"] == pytest.approx(5.0 * np.sqrt(2 / 3))
    assert set(found) == set(SUMMARY_UNITS)


def test_a_record_without_a_turn_has_no_lines():
    still = record()
    still.samples[:, ROTOR_ANGLE] = 1.0
    found = summary(still)
    assert np.isnan(found["speed_line_2"])
    assert found["duration"] == pytest.approx(0.45)


def test_results_become_columns():
    assert as_columns(2.0)["result"].shape == ()
    assert as_columns({"a": [1, 2], "b": "x"})["a"].shape == (2,)
    with pytest.raises(UsageError, match="numbers"):
        as_columns({"a": object()})
