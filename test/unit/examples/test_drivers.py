"""The examples of drivers, without a graph: what they refuse, and what a controller takes."""

import runpy

import pytest
from builtin_interfaces.msg import Duration
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ema_record.actuator import load_actuator
from ema_record.profile import load_profile, profile_names
from ema_record.wire.trajectory import encode_command

ACTUATOR = load_actuator()
NOW = 1_700_000_000 * 10**9


@pytest.fixture(scope="module")
def way(repository):
    return runpy.run_path(str(repository / "examples" / "hardware.py"))["way"]


@pytest.fixture(scope="module")
def refusal(repository):
    """Return why the controller that the tests of the drivers use refuses a trajectory."""
    return runpy.run_path(str(repository / "test/ros/joint_trajectory_controller.py"))["refusal"]


@pytest.mark.parametrize("name", ["driver.py", "capture_driver.py"])
def test_an_example_is_short(repository, name):
    assert len((repository / "examples" / name).read_text().splitlines()) < 100


def test_a_step_is_a_way_there_and_a_profile_is_itself(way):
    points, problem = way([(1e-3, 0.2)], -0.4, ACTUATOR)
    assert problem == ""
    assert (points[0][1], points[-1][1]) == (-0.4, 0.2)
    assert points[-1][0] > 0.6 / ACTUATOR.slew_speed
    given = list(load_profile("extended").points)
    assert way(given, -0.4, ACTUATOR) == (given, "")


@pytest.mark.parametrize(("points", "word"), [
    ([(0.0, 0.0), (1.0, 1.01 * ACTUATOR.surface.end_stop)], "end stops"),
    ([(1e-3, -1.01 * ACTUATOR.surface.end_stop)], "end stops"),
    ([(0.0, 0.0), (0.1, 0.12 * ACTUATOR.slew_speed)], "rad/s"),
])
def test_what_the_drive_cannot_do_is_refused(way, points, word):
    assert word in way(points, 0.0, ACTUATOR)[1]


@pytest.mark.parametrize("name", profile_names())
def test_the_controller_takes_every_test_as_it_is_commanded(name, refusal):
    message = deserialize_message(encode_command(load_profile(name), NOW), JointTrajectory)
    assert refusal(message, NOW) == ""


def point(seconds, positions=(0.1,), velocities=()):
    whole = round(seconds * 1e9)
    return JointTrajectoryPoint(
        positions=list(positions), velocities=list(velocities),
        time_from_start=Duration(sec=whole // 10**9, nanosec=whole % 10**9))


@pytest.mark.parametrize(("joints", "points", "word"), [
    (["elbow"], [point(0.1)], "joints"),
    (["surface", "elbow"], [point(0.1, (0.1, 0.2))], "joints"),
    (["surface"], [], "empty"),
    (["surface"], [point(0.1), point(0.1)], "strictly increasing"),
    (["surface"], [point(0.2), point(0.1)], "strictly increasing"),
    (["surface"], [point(0.1, ())], "positions"),
    (["surface"], [point(0.1, velocities=[0.5])], "velocity"),
])
def test_the_controller_refuses_what_it_is_documented_to_refuse(
    joints, points, word, refusal
):
    assert word in refusal(JointTrajectory(joint_names=joints, points=points), NOW)


def test_a_trajectory_that_has_ended_is_refused_and_one_without_a_stamp_begins_now(refusal):
    message = JointTrajectory(joint_names=["surface"], points=[point(0.5)])
    assert refusal(message, NOW) == ""
    message.header.stamp.sec = NOW // 10**9
    assert refusal(message, NOW + 4 * 10**8) == ""
    assert "past" in refusal(message, NOW + 6 * 10**8)
