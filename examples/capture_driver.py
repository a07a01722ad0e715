"""A driver of a drive that is read out after the move, and is moved by a trajectory controller.

The moves go to the topic of a joint_trajectory_controller (ros2_control), idle is what
`joint_states` says. The drive controls its currents in the rotor's frame; its buffer is a file
that its own tool writes after the move. `driver.py` does the rest. Parameters: `buffer`, the
file; `pace`, how much faster than they were taken samples are published, 0: at once.
"""
import math
import time
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Duration
from driver import Driver
from hardware import BLOCK, run, way
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ema_record.actuator import load_actuator
from ema_record.channels import label_of, recorded_columns
from ema_record.wire.rotor_frame import RotorFrame

AT_REST, HOLD = 0.01, 0.05  # of the slew speed; s


class CaptureHardware:
    acquisition, dc_bus = "capture", None

    def __init__(self, node):
        self.actuator = load_actuator()
        self.buffer = Path(node.declare_parameter("buffer", "drive.npz").value)
        self.pace = node.declare_parameter("pace", 0.0).value
        self.controller = node.create_publisher(
            JointTrajectory, "joint_trajectory_controller/joint_trajectory", 10)
        node.create_subscription(JointState, "joint_states", self.on_joint_states, 10)
        self.blocks, self.stopped, self.moving = [], False, False
        self.surface_position = math.nan  # a status without a number counts as none
        self.speed = self.begin = self.end = self.first = 0.0

    @property
    def active(self):
        return self.moving or bool(self.blocks)

    def on_joint_states(self, message):
        joint = message.name.index("surface")
        if self.controller.get_subscription_count():
            self.surface_position, self.speed = message.position[joint], message.velocity[joint]

    def move(self, points):
        points, problem = way(points, self.surface_position, self.actuator)
        problem = "the last move is being read out" if self.blocks else problem
        if not problem:
            self.buffer.unlink(missing_ok=True)
            self.send(points)
            self.stopped = False
        return problem

    def stop(self):
        self.send([(HOLD, self.surface_position)])
        self.blocks, self.stopped = [], True

    def send(self, points):
        message = JointTrajectory(joint_names=["surface"], points=[
            JointTrajectoryPoint(positions=[position], time_from_start=Duration(
                sec=int(t), nanosec=round(t % 1.0 * 1e9))) for t, position in points])
        self.controller.publish(message)  # without a stamp: it begins when it arrives
        self.moving, self.end = True, time.monotonic() + points[-1][0]

    def read(self):
        """Return (label, samples) of the blocks that are due, once the surface is at rest."""
        now = time.monotonic()
        rest = abs(self.speed) < AT_REST * self.actuator.slew_speed
        if self.moving and now > self.end and rest and (self.stopped or self.buffer.exists()):
            self.blocks = [] if self.stopped else self.read_out()
            self.moving, self.begin = False, time.monotonic()
        while self.blocks:
            due = now if self.pace == 0.0 else self.begin + (
                self.blocks[0][1][-1, 0] - self.first) / self.pace
            if due > now:
                return
            yield self.blocks.pop(0)

    def read_out(self):
        drive = np.load(self.buffer)
        samples = RotorFrame(self.actuator).samples(
            drive["time"], drive["speed"], drive["i_q"], d=drive["i_d"], angle=drive["angle"],
            reference_q=drive["ref_q"], reference_d=drive["ref_d"], position=drive["position"])
        columns = recorded_columns(samples)
        self.first = samples[0, 0]
        return [(label_of(columns), samples[first:first + BLOCK, columns])
                for first in range(0, len(samples), BLOCK)]


if __name__ == "__main__":
    run(lambda: Driver(CaptureHardware))
