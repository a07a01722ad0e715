"""A driver of an actuator, written against docs/driver.md; `Hardware` stands for the drive."""
import array
import time

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool, Float64MultiArray, Header, MultiArrayDimension
from trajectory_msgs.msg import JointTrajectory

from ema_record.actuator import load_actuator
from ema_record.errors import UsageError
from ema_record.profile import Profile
from ema_sim.session import ActuatorSession as Hardware

CHANNELS = ("time[s],motor_speed[rad/s],phase_current_a[A],phase_current_b[A],phase_current_c[A],"
            "reference_current_a[A],reference_current_b[A],reference_current_c[A],"
            "rotor_angle[rad],surface_position[rad]")
BLOCK, OFF, FRESH, SILENCE = 400, 0.02, 1.0, 1.0  # samples; s
OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN


class Driver(Node):
    def __init__(self):
        super().__init__("driver")
        self.hardware = Hardware(load_actuator(), position=-0.4)
        self.status, self.stopped, self.pending = (OK, "ready"), False, None
        self.stamp = self.start = self.done = 0
        self.wheels, self.sign = (False, 0.0), (0, 0.0)
        keep_all = QoSProfile(history=HistoryPolicy.KEEP_ALL)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.samples = self.create_publisher(Float64MultiArray, "ema/samples", keep_all)
        self.bus = self.create_publisher(BatteryState, "ema/dc_bus", 10)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(JointTrajectory, "ema/command", self.on_command, 10)
        self.create_subscription(Bool, "/aircraft/weight_on_wheels", lambda message: setattr(
            self, "wheels", (message.data, time.monotonic())), latched)
        self.create_subscription(Header, "ema/deadman", lambda message: setattr(
            self, "sign", (nanoseconds(message.stamp), time.monotonic())), 10)
        self.create_timer(0.005, self.tick)
        self.create_timer(0.1, self.report)

    def on_command(self, message):
        self.pending = message, time.monotonic()  # until all readers of the samples are there

    def accept(self, message):
        at, joint = self.hardware.surface_position, message.joint_names.index("surface")
        points = [(1e-9 * nanoseconds(p.time_from_start), p.positions[joint])
                  for p in message.points]
        if len(points) == 1:  # be there, as fast as it can
            goal = points[0][1]
            points = [(0.0, at), (OFF, at), (OFF, goal), (OFF + 0.2 + abs(goal - at), goal)]
        try:
            if not (self.wheels[0] and time.monotonic() - self.wheels[1] <= FRESH):
                raise UsageError("no fresh weight on wheels")
            idle = not self.hardware.active
            self.hardware.command(Profile(name="command", points=points))  # knows its end stops
        except (UsageError, ValueError) as error:
            return self.report((WARN, f"command refused: {error}"))
        if idle:
            self.begin, self.start, self.done = time.monotonic(), time.time_ns(), 0
        self.stamp, self.stopped = nanoseconds(message.header.stamp), False
        return self.report((OK, "command accepted"))

    def tick(self):
        now = time.monotonic()
        if self.pending is not None and (now > self.pending[1] + 1.0 or (
                self.samples.get_subscription_count() >= self.count_subscribers("ema/samples"))):
            message, self.pending = self.pending[0], None
            self.accept(message)
        dead = self.sign[0] == self.stamp and now - self.sign[1] > SILENCE
        unsafe = dead or not self.wheels[0] or now - self.wheels[1] > FRESH
        if self.hardware.active and unsafe and not self.stopped:
            hold = [(0.0, self.hardware.surface_position), (0.1, self.hardware.surface_position)]
            self.hardware.command(Profile(name="stop", points=hold))
            self.stopped, self.status = True, (WARN, "stopped: off the wheels, or nobody commands")
        while self.hardware.active and self.done + BLOCK <= (
                time.monotonic() - self.begin) * self.hardware.rate:
            block = self.hardware.advance(BLOCK)
            message = Float64MultiArray(data=array.array("d", block.tobytes()))
            message.layout.dim = [
                MultiArrayDimension(label="sample", size=len(block), stride=block.size),
                MultiArrayDimension(label=CHANNELS, size=block.shape[1], stride=block.shape[1])]
            self.samples.publish(message)
            self.done += len(block)
            if not self.hardware.active:
                self.report()

    def report(self, status=None):
        self.status = status or self.status
        now = time.time_ns()
        header = Header(stamp=Time(sec=now // 10**9, nanosec=now % 10**9))
        voltage, current = self.hardware.dc_bus
        self.bus.publish(BatteryState(header=header, voltage=voltage, current=-current))
        values = {"state": "active" if self.hardware.active else "idle", "start_time": self.start,
                  "surface_position": self.hardware.surface_position, "command_stamp": self.stamp,
                  "samples_published": self.done}
        self.diagnostics.publish(DiagnosticArray(header=header, status=[DiagnosticStatus(
            name=f"{self.get_namespace().rstrip('/')}/driver: actuator", level=self.status[0],
            message=self.status[1], hardware_id="EXAMPLE-1",
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])]))


def nanoseconds(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Driver())
