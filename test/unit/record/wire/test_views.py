"""Decimated views: closed forms, streaming, and what a ROS node reads."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ema_record.channels import N_CHANNELS, ROTOR_ANGLE
from ema_record.wire.sensors import bus_reading, encode_dc_bus, encode_temperature
from ema_record.wire.views import ViewDecimator

RATE = 20_000.0


def test_a_constant_slew():
    """Means of a straight line lie on it; its speed comes out; currents average."""
    time = (np.arange(1000) + 0.5) / RATE
    samples = np.zeros((1000, N_CHANNELS))
    samples[:, 0] = time
    samples[:, 1] = 790.0
    samples[:, 2:5] = [1.0, -3.0, 2.0]
    samples[:, ROTOR_ANGLE] = 790.0 * time
    samples[:, 9] = 1.58 * time
    views = ViewDecimator(RATE).push(samples)
    assert len(views.time) == 100
    np.testing.assert_allclose(np.diff(views.time), 1.0 / 2000.0)
    np.testing.assert_allclose(views.position[:, 0], 790.0 * views.time)
    np.testing.assert_allclose(views.position[:, 1], 1.58 * views.time)
    np.testing.assert_allclose(views.velocity[1:], np.tile([790.0, 1.58], (99, 1)), rtol=1e-9)
    assert views.velocity[0].tolist() == [790.0, 0.0]
    np.testing.assert_allclose(views.phase_current, np.tile([1.0, -3.0, 2.0], (100, 1)))


def test_an_angle_that_wraps_is_not_averaged_over_the_wrap():
    time = (np.arange(2000) + 0.5) / RATE
    samples = np.zeros((2000, N_CHANNELS))
    samples[:, 0] = time
    samples[:, ROTOR_ANGLE] = np.mod(790.0 * time, 2 * np.pi)
    views = ViewDecimator(RATE).push(samples)
    error = views.position[:, 0] - 790.0 * views.time
    np.testing.assert_allclose(np.mod(error + np.pi, 2 * np.pi) - np.pi, 0.0, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 60), min_size=1, max_size=12), st.sampled_from([2e3, 7e3, 2e4]))
def test_block_by_block_gives_the_same(lengths, rate):
    n = sum(lengths)
    samples = np.random.default_rng(n).normal(size=(n, N_CHANNELS))
    samples[:, 0] = (np.arange(n) + 0.5) / rate
    whole = ViewDecimator(rate).push(samples)
    decimator, at, parts = ViewDecimator(rate), 0, []
    for length in lengths:
        parts.append(decimator.push(samples[at:at + length]))
        at += length
    for name in ("time", "position", "velocity", "phase_current"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(whole, name))


@pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # an old lark of rclpy's
def test_what_rclpy_reads():
    from geometry_msgs.msg import Vector3Stamped
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import BatteryState, JointState, Temperature

    rng = np.random.default_rng(3)
    samples = rng.normal(size=(40, N_CHANNELS))
    samples[:, 0] = (np.arange(40) + 0.5) / RATE
    start = 1_790_000_000_999_900_000
    views = ViewDecimator(RATE).push(samples)
    stamps = views.stamps(start)
    for k, data in enumerate(views.joint_states(start)):
        message = deserialize_message(data, JointState)
        assert message.name == ["motor", "surface"] and len(message.effort) == 0
        assert message.position.tolist() == views.position[k].tolist()
        assert message.velocity.tolist() == views.velocity[k].tolist()
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamps[k]
    for k, data in enumerate(views.phase_currents(start)):
        vector = deserialize_message(data, Vector3Stamped).vector
        assert [vector.x, vector.y, vector.z] == views.phase_current[k].tolist()
    bus = deserialize_message(encode_dc_bus(stamps[:1], [96.5], [1.25])[0], BatteryState)
    assert (bus.voltage, bus.current, bus.present) == (96.5, -1.25, True)
    assert np.isnan(bus.percentage) and bus.location == "dc_bus"
    assert bus.power_supply_status == BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    assert bus_reading(bus) == (96.5, 1.25)
    bus.location, bus.power_supply_status = "rig", BatteryState.POWER_SUPPLY_STATUS_UNKNOWN
    assert bus_reading(bus) == (96.5, 1.25), "a bag of somebody else, by the standard"
    winding = deserialize_message(encode_temperature(stamps[:1], [21.5])[0], Temperature)
    assert (winding.temperature, winding.variance) == (21.5, 0.0)
