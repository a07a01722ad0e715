"""The node `ema_sim`: an emulated actuator on the topics of the graph."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import rclpy
import rclpy.executors
from trajectory_msgs.msg import JointTrajectory

from ema_record.errors import EmaError, UsageError
from ema_record.wire.topics import (
    COMMAND,
    DC_BUS,
    JOINT_STATES,
    PHASE_CURRENTS,
    SAMPLES,
    WINDING_TEMPERATURE,
)
from ema_record.wire.trajectory import command_points
from ema_record.wire.types import stamp_of
from ema_ros.messages import (
    ERROR,
    OK,
    WARN,
    DiagnosticsPublisher,
    EmaNode,
    declare_parameters,
    diagnostic_status,
    given_parameters,
    make_publisher,
    make_subscription,
    make_timer,
    on_parameters,
    try_publish,
    use_given_kit,
)
from ema_ros.parameters import ParameterSpec, Value
from ema_ros.process import StopSignal, report, run_node
from ema_sim.node.server import ActuatorServer
from ema_sim.node.settings import MODEL_FILE, load_model, parameter_specs, settings_from

NODE_NAME = "ema_sim"
TICK = 0.005
"""Interval at which due blocks are looked for (s)."""
DIAGNOSTICS_PERIOD = 1.0
MATCH_TIMEOUT = 1.0
"""Longest wait, after a command, for all readers of the samples to be matched (s)."""
SLOW_READER = ParameterSpec(
    name="slow_reader_timeout", default=8.0, lower=0.5, upper=600.0, unit="s", read_only=True,
    text="longest wait for a slow reader; one that was killed stops counting after 5 s",
)


class SlowReaderError(EmaError):
    """A reader of the samples takes nothing."""


class SimulatorNode(EmaNode):
    """Executes commands on `/ema/command`, publishes what the transducers measure."""

    def __init__(self, stop: StopSignal) -> None:
        """Read the parameters, compile, then appear on the graph."""
        super().__init__(NODE_NAME, stop)
        use_given_kit(self)
        model_file = given_parameters(self).get(MODEL_FILE.name, MODEL_FILE.default)
        self._model = load_model(str(MODEL_FILE.check(model_file)))
        specs = parameter_specs(self._model)
        self._values = declare_parameters(self, [*specs, SLOW_READER])
        self._slow_reader = float(self._values[SLOW_READER.name])
        settings = settings_from(self._values, self._model)
        self._server = ActuatorServer(settings)
        on_parameters(self, specs, self._reconfigure)
        self._outputs = {
            topic: make_publisher(self, topic)
            for topic in (SAMPLES, JOINT_STATES, PHASE_CURRENTS, DC_BUS, WINDING_TEMPERATURE)
        }
        self._diagnostics = DiagnosticsPublisher(self)
        self._message = "ready"
        self._level = OK
        self._pending: tuple[float, list[tuple[float, float]], int] | None = None
        make_subscription(self, COMMAND, self._on_command)
        make_timer(self, TICK, self._tick)
        make_timer(self, DIAGNOSTICS_PERIOD, self._publish_status)
        self.get_logger().info("ready")

    def _on_command(self, message: JointTrajectory) -> None:
        try:
            points = command_points(message)
        except EmaError as error:
            self._refuse(error)
            return
        self._pending = (time.monotonic() + MATCH_TIMEOUT, points, stamp_of(message))
        self._begin_pending()

    def _begin_pending(self) -> None:
        """Begin the command that waits once every reader will get its first sample."""
        if self._pending is None:
            return
        deadline, points, stamp = self._pending
        matched = self._outputs[SAMPLES].get_subscription_count()
        if matched < self.count_subscribers(SAMPLES) and time.monotonic() < deadline:
            return
        self._pending = None
        try:
            self._server.command(points, stamp)
        except EmaError as error:
            self._refuse(error)
            return
        self._level, self._message = OK, "command accepted"
        self._publish_status()

    def _refuse(self, error: EmaError) -> None:
        self.get_logger().warning(f"command refused: {error}")
        self._level, self._message = WARN, f"command refused: {error}"
        self._publish_status()

    def _tick(self) -> None:
        self._begin_pending()
        was_active = self._server.active
        try:
            for topic, data in self._server.poll():
                self._publish(topic, data)
        except SlowReaderError as error:
            self._server.give_up()
            self.get_logger().error(str(error))
            self._level, self._message = ERROR, str(error)
            self._publish_status()
            return
        except EmaError as error:
            self.get_logger().fatal(str(error))
            report(f"error: {error}")
            self.exit_status = error.exit_status
            return
        if was_active and not self._server.active:
            self._message = "command executed"
            self._publish_status()

    def _publish(self, topic: str, data: bytes) -> None:
        """Publish; a full history of slow readers is waited for, so that nothing is lost."""
        end = time.monotonic() + self._slow_reader
        while not self._stop:
            if try_publish(self._outputs[topic], data):
                return
            self.get_logger().warning(
                f"{topic}: a reader is slow, waiting for it", throttle_duration_sec=1.0
            )
            if time.monotonic() > end:
                raise SlowReaderError(
                    f"{topic}: a reader took nothing for {self._slow_reader:g} s: run given up"
                )

    def _publish_status(self) -> None:
        values = self._server.status()
        values["sample_readers"] = str(self._outputs[SAMPLES].get_subscription_count())
        self._diagnostics.publish(diagnostic_status(
            "ema_sim: actuator", self._level, self._message, values,
            self._server.settings.serial_number,
        ))

    def _reconfigure(self, changed: dict[str, Value]) -> None:
        if not changed:
            return
        if self._server.active:
            raise UsageError(
                f"parameter {next(iter(changed))}: the actuator executes a command: "
                "set it when it is idle"
            )
        values = {**self._values, **changed}
        self._server.reconfigure(settings_from(values, self._model))
        self._values = values

    def shut_down(self) -> None:
        """Nothing is left to do: the samples of a run that is cut are simply not made."""


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    sys.exit(run_node(rclpy, SimulatorNode, args))


if __name__ == "__main__":
    main()
