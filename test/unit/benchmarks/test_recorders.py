"""Poorer recorders, made of one record."""

import numpy as np
import pytest

from benchmarks.any_actuator.channels import BITS_LESS, RECORDERS, coarser, half_the_rate
from ema_record.actuator import load_actuator
from ema_record.channels import MOTOR_SPEED, PHASE_CURRENTS, ROTOR_ANGLE
from support.simulations import slewing_record

ACTUATOR = load_actuator()


def test_half_the_rate_is_the_mean_of_two_samples():
    record = slewing_record(current=6.0, noise=0.1, seed=3)
    found, actuator = half_the_rate(record, ACTUATOR)
    assert len(found) == len(record) // 2
    assert found.rate == pytest.approx(0.5 * record.rate)
    assert actuator.acquisition.rate == 0.5 * ACTUATOR.acquisition.rate
    speed = record.channel("motor_speed")
    assert found.channel("motor_speed") == pytest.approx(0.5 * (speed[0::2] + speed[1::2]))
    # Across the jump of the angle too: it grows by the speed.
    steps = np.diff(np.unwrap(found.samples[:, ROTOR_ANGLE]))
    assert steps == pytest.approx(790.6 / found.rate, rel=1e-6)


def test_fewer_bits_are_larger_steps():
    record = slewing_record(current=6.0, noise=5.0, seed=4)
    found, actuator = coarser(record, ACTUATOR)
    c = actuator.converters
    assert c.speed_bits == ACTUATOR.converters.speed_bits - BITS_LESS
    step = c.speed_range / 2.0**c.speed_bits
    counts = found.samples[:, MOTOR_SPEED] / step
    assert counts == pytest.approx(np.round(counts), abs=1e-6)
    assert np.abs(found.samples[:, MOTOR_SPEED] - record.samples[:, MOTOR_SPEED]).max() <= (
        0.501 * step)


def test_every_recorder_has_what_is_needed_and_leaves_the_record_alone():
    record = slewing_record(current=6.0)
    before = record.samples.copy()
    for recorder in RECORDERS.values():
        found, _ = recorder(record, ACTUATOR)
        assert np.isfinite(found.samples[:, [0, MOTOR_SPEED]]).all()
        assert np.isfinite(found.samples[:, PHASE_CURRENTS]).all(axis=0).sum() >= 2
    np.testing.assert_array_equal(record.samples, before)
