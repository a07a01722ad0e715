"""What stands for the drive in driver.py: an emulated one that streams while it moves."""
import time

from ema_record.actuator import load_actuator
from ema_record.channels import CHANNEL_LABEL
from ema_record.errors import UsageError
from ema_record.profile import Profile
from ema_sim.session import ActuatorSession

BLOCK, OFF, STEP = 400, 0.02, 2e-9  # samples; s; points that are nearer are a step


class Hardware(ActuatorSession):
    acquisition = "stream"

    def __init__(self, node):
        super().__init__(load_actuator(), position=-0.4)
        self.stopped, self.begin, self.done = False, 0.0, 0

    def move(self, points):
        """Move through (time (s), position (rad)); return why it does not, empty: it does."""
        speed, at, idle = self.actuator.slew_speed, self.surface_position, not self.active
        if len(points) == 1:  # be there, as fast as it can
            ((_, goal),) = points
            points = [(0.0, at), (OFF, at), (OFF, goal), (OFF + 0.2 + abs(goal - at), goal)]
        for (t0, p0), (t1, p1) in zip(points, points[1:]):
            if t1 - t0 > STEP and abs(p1 - p0) > 1.05 * speed * (t1 - t0):
                return f"{abs(p1 - p0) / (t1 - t0):.3g} rad/s, at most {speed:.3g} rad/s"
        try:
            self.command(Profile(name="command", points=points))
        except (UsageError, ValueError) as error:  # end stops, times
            return str(error)
        if idle:
            self.begin, self.done = time.monotonic(), 0
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
