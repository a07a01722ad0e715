"""The profile as JointTrajectory and back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ema_record.actuator import load_actuator
from ema_record.errors import InvalidRecordError, UsageError
from ema_record.profile import MAX_POSITION, Profile, load_profile, profile_names, step_profile
from ema_record.wire.trajectory import (
    JOINT_TRAJECTORY,
    command_points,
    decode_command,
    encode_command,
    increasing,
    profile_from_points,
    steps_joined,
)
from ema_record.wire.types import deserialize, message_class, serialize

POSITIONS = st.floats(-MAX_POSITION, MAX_POSITION)
TIMES = st.integers(0, 600_000_000).map(lambda t: 100 * t)
"""Ns; points that are nearer than the points of a step are one."""


@st.composite
def profiles(draw):
    times = sorted(draw(st.lists(TIMES, min_size=2, max_size=30)))
    times += draw(st.lists(st.sampled_from(times), max_size=20))  # steps, of several points too
    times.sort()
    if times[-1] == 0:
        times[-1] = 100
    points = [(t / 1e9, draw(POSITIONS)) for t in times]
    return Profile(name="command", points=points)


@settings(max_examples=200, deadline=None)
@given(profiles(), st.integers(0, 2**31 * 10**9 - 1))
def test_round_trip(profile, stamp):
    """Times to the nanosecond and positions come back exactly."""
    assert decode_command(encode_command(profile, stamp)).points == profile.points


def times_of(data):
    message = deserialize(data, JOINT_TRAJECTORY, "x")
    return [int(p.time_from_start.sec) * 10**9 + int(p.time_from_start.nanosec)
            for p in message.points]


@settings(max_examples=100, deadline=None)
@given(profiles())
def test_times_increase_strictly(profile):
    """What a joint trajectory controller asks of a message; moved by less than a sample."""
    times = times_of(encode_command(profile))
    assert times[0] >= 0 and all(b > a for a, b in zip(times, times[1:]))
    assert max(abs(t - 1e9 * p[0]) for t, p in zip(times, profile.points)) < 60.0


@pytest.mark.parametrize("name", profile_names())
def test_a_controller_that_interpolates_samples_the_same(name):
    """At each control period; the two points of a step are 1 ns apart, the later one in time."""
    profile, period = load_profile(name), load_actuator().control.period
    times = np.array(times_of(encode_command(profile)), dtype=np.int64)
    ticks = np.arange(0, 10**9 * int(np.ceil(profile.duration)), round(1e9 * period))
    k = np.clip(np.searchsorted(times, ticks, side="right") - 1, 0, len(times) - 2)
    part = np.clip((ticks - times[k]) / (times[k + 1] - times[k]), 0.0, 1.0)
    positions = np.array([position for _, position in profile.points])
    sampled = positions[k] + part * (positions[k + 1] - positions[k])
    np.testing.assert_allclose(sampled, profile.command(1e-9 * ticks + 1e-12), atol=1e-9)


def test_commands_of_before_are_read():
    """Two points at one time, as this software published them at first."""
    profile = load_profile("extended")
    message = deserialize(encode_command(profile), JOINT_TRAJECTORY, "x")
    message.points[1].time_from_start = message.points[2].time_from_start
    assert len(set(times_of(serialize(message, JOINT_TRAJECTORY)))) == len(message.points) - 1
    assert decode_command(serialize(message, JOINT_TRAJECTORY)) == profile


@pytest.mark.parametrize("times", [
    [0, 0, 5], [0, 0, 0, 5], [100, 100], [100, 100, 100], [0, 100, 100, 101, 101], [0, 5, 9],
])
def test_steps_are_parted_and_joined(times):
    parted = increasing(times)
    assert parted[0] >= 0 and all(b > a for a, b in zip(parted, parted[1:]))
    if 101 not in times:
        assert steps_joined(parted) == times == steps_joined(times)


@pytest.mark.parametrize("name", profile_names())
def test_shipped_profiles_are_recognised(name):
    assert decode_command(encode_command(load_profile(name))) == load_profile(name)


def test_other_profiles_are_not_taken_for_shipped_ones():
    profile = decode_command(encode_command(step_profile(0.7)))
    assert profile.name == "command"
    assert profile.points == step_profile(0.7).points


def test_one_point_is_a_step():
    assert profile_from_points([(0.022, 0.4)], start=-0.4001) == load_profile("step")
    other = profile_from_points([(0.03, 0.1)], start=-0.2, duration=0.5)
    assert other.command(np.array([0.0, 0.0299, 0.031, 0.5])).tolist() == [-0.2, -0.2, 0.1, 0.1]
    assert other.duration == 0.5
    assert profile_from_points([(0.022, 0.4)], start=None) == load_profile("step")


@pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # an old lark of rclpy's
def test_what_rclpy_makes_of_it():
    """A node reads the points, and its own message gives the profile back."""
    from rclpy.serialization import deserialize_message, serialize_message
    from trajectory_msgs.msg import JointTrajectory

    profile = load_profile("extended")
    message = deserialize_message(encode_command(profile, 5_000_000_007), JointTrajectory)
    assert message.header.stamp.sec == 5 and message.header.stamp.nanosec == 7
    assert profile_from_points(command_points(message)) == profile
    assert decode_command(serialize_message(message)) == profile


def test_another_joint_beside_the_surface():
    message = deserialize(encode_command(load_profile("step")), JOINT_TRAJECTORY, "x")
    message.joint_names = ["elevator", "surface"]
    for point in message.points:
        point.positions = np.array([9.0, point.positions[0]])
    assert decode_command(serialize(message, JOINT_TRAJECTORY)) == load_profile("step")


def changed(**changes):
    message = deserialize(encode_command(load_profile("step")), JOINT_TRAJECTORY, "x")
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def point(seconds, *positions):
    none = np.empty(0)
    duration = message_class("builtin_interfaces/msg/Duration")
    return message_class("trajectory_msgs/msg/JointTrajectoryPoint")(
        positions=np.array(positions, dtype=float), velocities=none, accelerations=none,
        effort=none, time_from_start=duration(sec=seconds, nanosec=0),
    )


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"joint_names": ["elevator"]}, "elevator.*expected 'surface'"),
        ({"joint_names": []}, r"\(none\)"),
        ({"points": []}, "0 points"),
        ({"points": [point(k, 0.0) for k in range(1001)]}, "1001 points"),
        ({"points": [point(0, 0.0), point(1)]}, "point 1 has 0 positions"),
        ({"points": [point(2, 0.0), point(1, 0.1)]}, "must not decrease"),
        ({"points": [point(0, 0.0), point(1, 11.0)]}, "less than or equal to 10"),
        ({"points": [point(0, 0.0), point(1, np.nan)]}, "finite"),
        ({"points": [point(0, 0.0), point(61, 0.1)]}, "less than or equal to 60"),
        ({"points": [point(-1, 0.0), point(1, 0.1)]}, "greater than or equal to 0"),
    ],
)
def test_bad_commands(changes, match):
    message = changed(**changes)
    with pytest.raises(UsageError, match=match):
        profile_from_points(command_points(message))
    with pytest.raises(InvalidRecordError, match=match):
        decode_command(serialize(message, JOINT_TRAJECTORY))


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200))
def test_noise_is_an_error_of_one_line(noise):
    with pytest.raises(InvalidRecordError) as caught:
        decode_command(noise)
    assert "\n" not in str(caught.value)


def test_shipped_profiles_are_read_once(monkeypatch):
    """A recording decodes its command many times a second."""
    load_profile("step")
    profile_from_points([(0.0, 0.0), (1.0, 0.1)])

    def refuse(path, **_):
        raise AssertionError(f"{path} is read again")

    monkeypatch.setattr("ema_record.profile.load_yaml", refuse)
    assert profile_from_points(load_profile("step").points) is load_profile("step")
    names = profile_names()
    names.clear()
    assert "step" in profile_names()


def test_a_file_of_the_user_is_read_every_time(tmp_path):
    path = tmp_path / "mine.yaml"
    for end in (0.1, 0.2):
        path.write_text(f"name: mine\npoints: [[0.0, 0.0], [1.0, {end}]]\n")
        assert load_profile(path).points[-1][1] == end
