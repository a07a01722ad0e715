"""A driver of an actuator, written against docs/driver.md; `Hardware` stands for the drive."""
import array
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hardware import Hardware, nanoseconds, run
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool, Float64MultiArray, Header, MultiArrayDimension
from trajectory_msgs.msg import JointTrajectory

OK, WARN, LIMIT = DiagnosticStatus.OK, DiagnosticStatus.WARN, 1.0  # s


class Driver(Node):
    def __init__(self, make_hardware=Hardware):
        super().__init__("driver")
        self.hardware = make_hardware(self)
        self.status, self.pending, self.stamp, self.start, self.done = (OK, "ready"), [], 0, 0, 0
        self.wheels, self.signs = (False, 0.0), {}  # what was heard, and when
        keep_all = QoSProfile(history=HistoryPolicy.KEEP_ALL)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.samples = self.create_publisher(Float64MultiArray, "ema/samples", keep_all)
        self.bus = self.create_publisher(BatteryState, "ema/dc_bus", 10)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(JointTrajectory, "ema/command", self.pending.append, 10)
        self.create_subscription(Bool, "/aircraft/weight_on_wheels", self.on_wheels, latched)
        self.create_subscription(Header, "ema/deadman", lambda message: self.signs.update(
            {nanoseconds(message.stamp): time.monotonic()}), 10)
        self.create_timer(0.005, self.tick)
        self.create_timer(0.1, self.report)

    def on_wheels(self, message):
        self.wheels = message.data, time.monotonic()
        self.stop_if_unsafe()  # for a moment is enough

    def off_wheels(self):
        return "" if self.wheels[0] and time.monotonic() - self.wheels[1] <= LIMIT else "airborne"

    def stop_if_unsafe(self):
        dead = time.monotonic() - self.signs.get(self.stamp, float("inf")) > LIMIT
        reason = self.off_wheels() or ("nobody commands" if dead else "")
        if self.hardware.active and not self.hardware.stopped and reason:
            self.hardware.stop()
            self.report((WARN, f"stopped: {reason}"))

    def accept(self, message):
        idle, joint = not self.hardware.active, message.joint_names.index("surface")
        refused = self.off_wheels() or self.hardware.move(  # it knows its end stops and speed
            [(1e-9 * nanoseconds(p.time_from_start), p.positions[joint]) for p in message.points])
        if refused:
            return self.report((WARN, f"command refused: {refused}"))
        if idle:
            self.start, self.done = self.get_clock().now().nanoseconds, 0
        self.stamp, self.signs = nanoseconds(message.header.stamp), {}
        return self.report((OK, "command accepted"))

    def tick(self):
        if self.pending:  # until all readers of the samples are matched
            age = self.get_clock().now().nanoseconds - nanoseconds(self.pending[0].header.stamp)
            readers = self.count_subscribers("ema/samples")
            if self.samples.get_subscription_count() >= readers or age > 1e9 * LIMIT:
                self.accept(self.pending.pop(0))
        self.stop_if_unsafe()
        active = self.hardware.active
        for label, block in self.hardware.read():  # those that are due
            dims = ("sample", len(block), block.size), (label, block.shape[1], block.shape[1])
            out = Float64MultiArray(data=array.array("d", block.tobytes()))
            out.layout.dim = [MultiArrayDimension(label=d, size=n, stride=m) for d, n, m in dims]
            self.samples.publish(out)
            self.done += len(block)
        if active and not self.hardware.active:
            self.report()

    def report(self, status=None):
        self.status, drive, bus = status or self.status, self.hardware, self.hardware.dc_bus
        header = Header(stamp=self.get_clock().now().to_msg())
        if bus:  # V, and A that it takes; None: not measured
            self.bus.publish(BatteryState(header=header, voltage=bus[0], current=-bus[1]))
        values = {"state": "active" if drive.active else "idle", "command_stamp": self.stamp,
                  "surface_position": drive.surface_position, "start_time": self.start,
                  "samples_published": self.done, "acquisition": drive.acquisition}
        self.diagnostics.publish(DiagnosticArray(header=header, status=[DiagnosticStatus(
            name=f"{self.get_fully_qualified_name()}: actuator", hardware_id="EXAMPLE-1",
            level=self.status[0], message=self.status[1],
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])]))


if __name__ == "__main__":
    run(Driver)
