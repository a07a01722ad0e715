"""The node `ema_sim`: an emulated actuator on the topics of the graph."""

from __future__ import annotations

import sys
import time

import rclpy
import rclpy.executors
from std_msgs.msg import Bool, Header
from trajectory_msgs.msg import JointTrajectory

from ema_record.errors import EmaError, TestRefusedError, UsageError
from ema_record.wire.topics import (
    COMMAND,
    DC_BUS,
    DEADMAN,
    JOINT_STATES,
    PHASE_CURRENTS,
    SAMPLES,
    WEIGHT_ON_WHEELS,
    WINDING_TEMPERATURE,
)
from ema_record.wire.trajectory import command_points
from ema_record.wire.types import NANOSECONDS, stamp_of
from ema_ros.ema_node import (
    DIAGNOSTICS_PERIOD,
    EmaNode,
    declare_parameters,
    given_parameters,
    on_parameters,
)
from ema_ros.interlock import DEFAULT_TIMEOUT, Deadman, Interlock
from ema_ros.messages import (
    ERROR,
    OK,
    WARN,
    DiagnosticsPublisher,
    PolledGroup,
    diagnostic_status,
    make_polled_subscription,
    make_publisher,
    make_subscription,
    make_timer,
    read_message,
    resolved,
    set_period,
    status_name,
    take_all,
    try_publish,
    unheard,
)
from ema_ros.parameters import ParameterSpec, Value
from ema_ros.process import StopSignal, report, run_node
from ema_sim.model_file import load_model_file
from ema_sim.node.server import ActuatorServer
from ema_sim.node.settings import MODEL_FILE, parameter_specs, settings_from

TICK = 0.010
"""Interval at which due blocks are looked for (s)."""
IDLE_TICK = 0.05
"""The same where nothing is executed (s): eight idle actuators cost little."""
MATCH_TIMEOUT = 1.0
"""Longest wait, after a command, for all readers of the samples to be matched (s)."""
ACTUATOR = "actuator"
"""Task of the status in which it reports."""
SLOW_READER = ParameterSpec(
    name="slow_reader_timeout", default=8.0, lower=0.5, upper=600.0, unit="s", read_only=True,
    text="longest wait for a slow reader; one that was killed stops counting after 5 s",
)
WHEELS = ParameterSpec(
    name="weight_on_wheels_timeout", default=DEFAULT_TIMEOUT, lower=0.1, upper=60.0, unit="s",
    read_only=True, text="age at which weight on wheels is stale, and the surface stopped",
)
SILENCE = ParameterSpec(
    name="deadman_timeout", default=DEFAULT_TIMEOUT, lower=0.1, upper=60.0, unit="s",
    read_only=True, text="silence on /ema/deadman, once heard, after which the surface is stopped",
)
SAFETY = (SLOW_READER, WHEELS, SILENCE)


class SlowReaderError(EmaError):
    """A reader of the samples takes nothing."""


class SimulatorNode(EmaNode):
    """Executes commands on `/ema/command`, publishes what the transducers measure.

    It obeys only while the aircraft says that it stands on its wheels, and stops by itself when
    that ends, or when who commands falls silent.
    """

    name = "ema_sim"

    def __init__(self, stop: StopSignal) -> None:
        super().__init__(stop)
        model_file = given_parameters(self).get(MODEL_FILE.name, MODEL_FILE.default)
        self._model = load_model_file(str(MODEL_FILE.check(model_file)) or None)
        specs = parameter_specs(self._model)
        self._values = declare_parameters(self, [*specs, *SAFETY])
        self._slow_reader = float(self._values[SLOW_READER.name])
        self._settings = settings_from(self._values, self._model)
        on_parameters(self, specs, self._reconfigure)
        self._server: ActuatorServer | None = None

    def configure(self) -> None:
        """Compile, and make the publishers."""
        self._server = ActuatorServer(self._settings)
        self._outputs = {
            topic: make_publisher(self, topic)
            for topic in (SAMPLES, JOINT_STATES, PHASE_CURRENTS, DC_BUS, WINDING_TEMPERATURE)
        }
        self._diagnostics = DiagnosticsPublisher(self)

    def activate(self) -> None:
        """Listen, and run what is commanded."""
        self._message, self._level = "ready", OK
        self._begun: float | None = None
        self._pending: tuple[float, list[tuple[float, float]], int] | None = None
        # Any moment off the wheels ends what runs; when to begin again is for who commands.
        self._interlock = Interlock(float(self._values[WHEELS.name]), hold=0.0)
        self._deadman = Deadman(float(self._values[SILENCE.name]))
        group = PolledGroup()
        self._polled = {topic: make_polled_subscription(self, topic, group)
                        for topic in (WEIGHT_ON_WHEELS, DEADMAN)}
        self._timer = make_timer(self, IDLE_TICK, self._tick)
        self.while_active(
            *self._polled.values(),
            make_subscription(self, COMMAND, self._on_command),
            self._timer,
            make_timer(self, DIAGNOSTICS_PERIOD, self._publish_status),
        )
        self.get_logger().info("ready")

    def deactivate(self) -> None:
        """Give up what runs."""
        self._actuator.give_up()

    @property
    def _actuator(self) -> ActuatorServer:
        assert self._server is not None
        return self._server

    def _on_command(self, message: JointTrajectory) -> None:
        try:
            points = command_points(message)
        except EmaError as error:
            self._refuse(error)
            return
        self._pending = (time.monotonic() + MATCH_TIMEOUT, points, stamp_of(message))
        set_period(self._timer, TICK)
        self._begin_pending()

    def _begin_pending(self) -> None:
        """Begin the command that waits once every reader will get its first sample."""
        if self._pending is None:
            return
        deadline, points, stamp = self._pending
        now = time.monotonic()
        matched = self._outputs[SAMPLES].get_subscription_count()
        self._listen()
        undecided = self._interlock.is_undecided(now, now)
        deaf = unheard(self, self._polled[DEADMAN])  # for a moment also while it is discovered
        if now < deadline and (
            undecided or deaf or matched < self.count_subscribers(resolved(self, SAMPLES))
        ):
            return
        self._pending = None
        try:
            if forbidden := self._interlock.reason(now):
                raise TestRefusedError(forbidden + unheard(self, self._polled[WEIGHT_ON_WHEELS]))
            if deaf:
                raise TestRefusedError(f"who commands would not be watched{deaf}")
            self._actuator.command(points, stamp)
        except EmaError as error:
            self._refuse(error)
            return
        self._begun = now
        set_period(self._timer, TICK)
        self._level, self._message = OK, "command accepted"
        self._publish_status()

    def _refuse(self, error: EmaError) -> None:
        self.get_logger().warning(f"command refused: {error}", throttle_duration_sec=1.0)
        why = f"stopped: {self._actuator.stopped}; " if self._actuator.stopped else ""
        self._level, self._message = WARN, f"{why}command refused: {error}"
        self._publish_status()

    def _listen(self) -> None:
        """Take what the aircraft and who commands have said."""
        for taken in take_all(self._polled[WEIGHT_ON_WHEELS]):
            transit = (time.time_ns() - taken.sent) / NANOSECONDS
            message = read_message(taken.data, Bool) or Bool()  # in doubt it is off
            self._interlock.update(message.data, time.monotonic(), transit)
        for taken in take_all(self._polled[DEADMAN]):
            sign = read_message(taken.data, Header)
            if sign is not None:
                self._deadman.update(stamp_of(sign), time.monotonic())

    def _stop_if_unsafe(self) -> None:
        """Stop the surface where the interlock is open or nobody watches; tell of any stop."""
        self._listen()
        actuator, now = self._actuator, time.monotonic()
        if not actuator.active:
            return
        if not actuator.stopped and (reason := self._interlock.reason(now, self._begun)
                                     or self._deadman.reason(actuator.command_stamp, now)):
            actuator.stop(reason)
        said = f"stopped: {actuator.stopped}"
        if actuator.stopped and not self._message.startswith(said):  # also of its own accord
            self.get_logger().warning(said)
            self._level, self._message = WARN, said
            self._publish_status()

    def _tick(self) -> None:
        self._begin_pending()
        self._stop_if_unsafe()
        if self._diagnostics.has_new_reader():
            self._publish_status()
        was_active = self._actuator.active
        try:
            for topic, data in self._actuator.poll():
                if topic == SAMPLES:  # several blocks may be due on a machine that is loaded
                    self._stop_if_unsafe()
                self._publish(topic, data)
        except SlowReaderError as error:
            self._actuator.give_up()
            self.get_logger().error(str(error))
            self._level, self._message = ERROR, str(error)
            self._publish_status()
            return
        except EmaError as error:
            self.get_logger().fatal(str(error))
            report(f"error: {error}")
            self.exit_status = error.exit_status
            return
        if not self._actuator.active and self._pending is None:
            set_period(self._timer, IDLE_TICK)
        if was_active and not self._actuator.active:
            if not self._actuator.stopped:
                self._message = "command executed"
            self._publish_status()

    def _publish(self, topic: str, data: bytes) -> None:
        """Publish; a full history of slow readers is waited for, so that nothing is lost."""
        end = time.monotonic() + self._slow_reader
        while not self._stop:
            if try_publish(self._outputs[topic], data):
                return
            self._stop_if_unsafe()
            self.get_logger().warning(
                f"{topic}: a reader is slow, waiting for it", throttle_duration_sec=1.0
            )
            if time.monotonic() > end:
                raise SlowReaderError(
                    f"{topic}: a reader took nothing for {self._slow_reader:g} s: run given up"
                )

    def _publish_status(self) -> None:
        values = self._actuator.status()
        values["sample_readers"] = str(self._outputs[SAMPLES].get_subscription_count())
        self._diagnostics.publish(diagnostic_status(
            status_name(self, ACTUATOR), self._level, self._message, values,
            self._actuator.settings.serial_number,
        ))

    def _reconfigure(self, changed: dict[str, Value]) -> None:
        if not changed:
            return
        if self._server is not None and self._server.active:
            raise UsageError(
                f"parameter {next(iter(changed))}: the actuator executes a command: "
                "set it when it is idle"
            )
        values = {**self._values, **changed}
        settings = settings_from(values, self._model)
        if self._server is not None:
            self._server.reconfigure(settings)
        self._settings, self._values = settings, values


def main() -> None:
    """Run the node."""
    sys.exit(run_node(rclpy, SimulatorNode.started))


if __name__ == "__main__":
    main()
