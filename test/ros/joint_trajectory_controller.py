"""Stands for ros2_control's joint_trajectory_controller and the drive behind it, as a process.

It refuses what that controller's `validate_trajectory_msg` does (ros2_controllers 4, Jazzy; its
user documentation): joints that are not all of its own, no points, points without a position for
each joint, times that do not increase strictly, a last point with a velocity, a stamped
trajectory that has ended. Positions alone are joined by straight lines, beginning at the stamp;
a new trajectory takes the place of the old one. The drive measures in the rotor's frame and is
read out after the move: into the file of the parameter ``buffer``.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from ema_record.actuator import load_actuator
from ema_record.channels import (
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
)
from ema_record.profile import Profile
from ema_record.wire.rotor_frame import rotor_currents
from ema_sim.effects import parse_effects
from ema_sim.plant.state import OMEGA_S
from ema_sim.session import ActuatorSession

JOINT = "surface"
PERIOD = 0.01
"""Of the controller (s)."""
NANOSECONDS = 10**9


def nanoseconds(time_message) -> int:
    """Return a time or a duration in ns."""
    return int(time_message.sec) * NANOSECONDS + int(time_message.nanosec)


def refusal(message: JointTrajectory, now: int) -> str:
    """Return why the controller refuses a trajectory at `now` (ns); empty: it takes it."""
    if list(message.joint_names) != [JOINT]:
        return "joints on incoming trajectory don't match the controller joints"
    if not message.points:
        return "empty trajectory received"
    if any(abs(v) > np.finfo(np.float32).eps for v in message.points[-1].velocities):
        return "velocity of last trajectory point is not zero"
    times = [nanoseconds(point.time_from_start) for point in message.points]
    begin = nanoseconds(message.header.stamp)
    if begin and begin + times[-1] < now:
        return "trajectory with non-zero start time ends in the past"
    for k, (earlier, after) in enumerate(zip(times, times[1:])):
        if after <= earlier:
            return f"time between points {k} and {k + 1} is not strictly increasing"
    if any(len(point.positions) != 1 for point in message.points):
        return "mismatch between joint_names and positions"
    return ""


class Controller(Node):
    """The controller, its drive, and the drive's tool."""

    def __init__(self) -> None:
        """Stand at the start of the tests."""
        super().__init__("joint_trajectory_controller")
        self._buffer = Path(self.declare_parameter("buffer", "drive.npz").value)
        effects = parse_effects(self.declare_parameter("effects", "").value.split())
        self._drive = ActuatorSession(load_actuator(), effects, position=-0.4)
        warm = ActuatorSession(load_actuator(), effects, position=-0.4)
        warm.command(Profile(name="warm", points=((0.0, -0.4), (0.01, -0.4))))
        warm.advance(1000)  # compiled before it is moved
        self._begin, self._taken = 0.0, []
        self.create_subscription(JointTrajectory, "~/joint_trajectory", self._on_trajectory, 10)
        self._states = self.create_publisher(JointState, "joint_states", 10)
        self.create_timer(PERIOD, self._update)

    def _on_trajectory(self, message: JointTrajectory) -> None:
        problem = refusal(message, time.time_ns())
        if problem:
            self.get_logger().error(f"refused: {problem}")
            return
        drive = self._drive
        points = [(nanoseconds(p.time_from_start) / NANOSECONDS, p.positions[0])
                  for p in message.points]
        if points[0][0] > 0.0:
            points.insert(0, (0.0, drive.surface_position))
        if not drive.active:
            self._begin, self._taken = time.monotonic(), []
        drive.command(Profile(name="trajectory", points=points))

    def _update(self) -> None:
        drive = self._drive
        if drive.active:
            n = int((time.monotonic() - self._begin - drive.time) * drive.rate)
            self._taken.append(drive.advance(max(n, 0)))
            if not drive.active:
                self._write()
        speed = float(drive.state[OMEGA_S]) if drive.active else 0.0
        message = JointState(name=[JOINT], position=[drive.surface_position], velocity=[speed])
        message.header.stamp = self.get_clock().now().to_msg()
        self._states.publish(message)

    def _write(self) -> None:
        """Write what the drive has measured, whole or not at all."""
        s = np.concatenate(self._taken)
        angle = s[:, ROTOR_ANGLE]
        d, q = rotor_currents(s[:, PHASE_CURRENTS], angle)
        ref_d, ref_q = rotor_currents(s[:, REFERENCE_CURRENTS], angle)
        part = self._buffer.with_suffix(".part.npz")
        np.savez(part, time=s[:, TIME], speed=s[:, MOTOR_SPEED], i_d=d, i_q=q,
                 ref_d=ref_d, ref_q=ref_q, angle=angle, position=s[:, SURFACE_POSITION])
        part.replace(self._buffer)


def main() -> None:
    """Run the controller until the process is ended."""
    from hardware import run  # of the examples

    run(Controller)


if __name__ == "__main__":
    main()
