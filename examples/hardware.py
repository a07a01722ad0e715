"""What stands for the drive in driver.py: an emulated one that streams while it moves.

And what drivers share: their times, and the life of their process.
"""
import signal
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from ema_record.actuator import load_actuator
from ema_record.channels import CHANNEL_LABEL
from ema_record.profile import Profile
from ema_sim.session import ActuatorSession

BLOCK, OFF, STEP = 400, 0.02, 2e-9  # samples; s; points that are nearer are a step


def way(points, at, actuator):
    """Return the points (s, rad) of a command, and what forbids them; at: of the surface (rad)."""
    if len(points) == 1:  # be there, as fast as it can
        ((_, goal),) = points
        slew = abs(goal - at) / actuator.slew_speed
        points = [(0.0, at), (OFF, at), (OFF + 1e-9, goal), (OFF + 0.2 + 1.2 * slew, goal)]
    stop, fastest = actuator.surface.end_stop, 1.05 * actuator.slew_speed
    for (t0, p0), (t1, p1) in zip([(0.0, points[0][1]), *points], points):
        if abs(p1) > stop:
            return points, f"{p1:g} rad is beyond the end stops, {stop:g} rad"
        if t1 - t0 > STEP and abs(p1 - p0) > fastest * (t1 - t0):
            return points, f"{abs(p1 - p0) / (t1 - t0):.3g} rad/s, at most {fastest:.3g} rad/s"
    return points, ""


def nanoseconds(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


def run(make_node):
    """Run a node until SIGINT or SIGTERM; its callbacks and the middleware are not torn apart.

    A handler that raises, or shuts the context down as rclpy's own does, becomes an error of
    whatever call it meets.
    """
    asked = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: asked.append(number))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor = SingleThreadedExecutor()
    executor.add_node(make_node())
    while not asked:
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    rclpy.shutdown()


class Hardware(ActuatorSession):
    """Paced by the clock; a block is due when its last sample is taken."""

    acquisition = "stream"

    def __init__(self, _node):
        super().__init__(load_actuator(), position=-0.4)
        self.stopped, self.begin, self.done = False, 0.0, 0

    def move(self, points):
        """Move; return why it does not, empty: it does."""
        points, problem = way(points, self.surface_position, self.actuator)
        if problem:
            return problem
        if not self.active:
            self.begin, self.done = time.monotonic(), 0
        self.command(Profile(name="command", points=points))
        self.stopped = False
        return ""

    def stop(self):
        """Hold the surface where it is, and end the run."""
        at = self.surface_position
        self.command(Profile(name="stop", points=((0.0, at), (0.1, at))))
        self.stopped = True

    def read(self):
        """Return (label, samples) of the blocks that are due."""
        while self.active and self.done + BLOCK <= (time.monotonic() - self.begin) * self.rate:
            block = self.advance(BLOCK)
            self.done += len(block)
            yield CHANNEL_LABEL, block
