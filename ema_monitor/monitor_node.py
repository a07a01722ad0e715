"""The node `ema_monitor`: the service that runs and records the built-in test."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import rclpy
import rclpy.executors
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from diagnostic_msgs.srv import SelfTest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from std_msgs.msg import Bool, String
from trajectory_msgs.msg import JointTrajectory

from ema_monitor.interlock import Interlock
from ema_monitor.messages import (
    PolledGroup,
    check_status,
    fill_response,
    find_actuator,
    in_order,
    level_status,
    make_polled_subscription,
)
from ema_monitor.recorder import BitRecorder, new_bag_path
from ema_monitor.sequence import (
    Action,
    ActuatorStatus,
    CloseRecord,
    Finish,
    Observation,
    OpenRecord,
    SendCommand,
    Stage,
    TestSequence,
)
from ema_monitor.settings import SPECS
from ema_record.actuator import load_actuator
from ema_record.checks.live import CheckResult, Level, check_counters, check_record, worst
from ema_record.errors import EmaError, UsageError
from ema_record.profile import load_profile
from ema_record.wire.topics import (
    BAG_TOPICS,
    BIT_RECORD,
    COMMAND,
    DIAGNOSTICS,
    SAMPLES,
    SELF_TEST_SERVICE,
    WEIGHT_ON_WHEELS,
)
from ema_record.wire.trajectory import encode_command
from ema_record.wire.types import stamp_of
from ema_ros.messages import (
    EmaNode,
    declare_parameters,
    make_publisher,
    make_timer,
    take_all,
    use_given_kit,
)
from ema_ros.process import SHUT_DOWN, StopSignal, run_node

NODE_NAME = "ema_monitor"
POLL_PERIOD = 0.02
DIAGNOSTICS_PERIOD = 1.0
LOOK_FOR_OTHERS = 0.6
"""How long the node looks for another monitor before it offers its service (s)."""
RUNNING = "refused: a test is running already: wait for its end"
ACTUATOR_TIMEOUT = 3.0
"""Age at which the status of the actuator is no longer believed (s); it sends one a second."""


class Request:
    """A caller of the service, waiting for the end of its test."""

    def __init__(self) -> None:
        """Begin to wait."""
        self.asked = time.monotonic()
        self.ended = Future()
        """Its result: why the test did not run to its end; empty: it did."""
        self.statuses: list[DiagnosticStatus] = []
        self.passed = False


class MonitorNode(EmaNode):
    """Runs the built-in test on request; all of it happens in one timer, the poll."""

    def __init__(self, stop: StopSignal) -> None:
        """Read the parameters, look for another monitor, then offer the service."""
        super().__init__(NODE_NAME, stop)
        use_given_kit(self)
        values = declare_parameters(self, SPECS)
        self._directory = Path(str(values["output_directory"]))
        self._serial = str(values["serial_number"])
        self._interlock = Interlock(float(values["weight_on_wheels_timeout"]))
        self._described = load_actuator(str(values["model_file"]) or None)
        self._sequence = TestSequence(
            load_profile(str(values["profile"])), self._described,
            stream_timeout=float(values["stream_timeout"]),
            test_timeout=float(values["test_timeout"]),
        )
        self._refuse_second_monitor()
        self._recorder = BitRecorder()
        self._actuator: ActuatorStatus | None = None
        self._actuator_heard = 0.0
        self._began: float | None = None
        self._request: Request | None = None
        self._waiting: list[Request] = []
        self._callers = 0
        self._sent: set[int] = set()
        self._foreign = False
        self._last_block = -1.0
        self._last_reason, self._failed = "no test yet", False
        group = PolledGroup()
        self._polled = {
            topic: make_polled_subscription(self, topic, group)
            for topic in (*(entry.name for entry in BAG_TOPICS), DIAGNOSTICS)
        }
        self._command = make_publisher(self, COMMAND)
        self._record = make_publisher(self, BIT_RECORD)
        self._diagnostics = make_publisher(self, DIAGNOSTICS)
        make_timer(self, POLL_PERIOD, self._poll)
        make_timer(self, DIAGNOSTICS_PERIOD, self._publish_status)
        self.create_service(
            SelfTest, "~/self_test", self._self_test, callback_group=ReentrantCallbackGroup()
        )
        self.get_logger().info("ready")

    def _refuse_second_monitor(self) -> None:
        end = time.monotonic() + LOOK_FOR_OTHERS
        while time.monotonic() < end and not self._stop:
            if self.count_services(SELF_TEST_SERVICE):
                raise UsageError(
                    f"another monitor offers {SELF_TEST_SERVICE} on this domain: stop it, or "
                    "set another ROS_DOMAIN_ID"
                )
            time.sleep(0.02)

    async def _self_test(
        self, _: SelfTest.Request, response: SelfTest.Response
    ) -> SelfTest.Response:
        """Wait for the end of the test without holding up the poll, however many callers wait."""
        request = Request()
        self._waiting.append(request)
        self._callers += 1
        reason = await request.ended
        self._callers -= 1
        outcome = level_status(
            "ema_monitor: test",
            Level.OK if request.passed else Level.ERROR,
            reason or ("passed" if request.passed else "record checks failed"), {},
        )
        return fill_response(
            response, self._serial, request.passed, [outcome, *request.statuses]
        )

    def _poll(self) -> None:
        """Take what has arrived, then let the sequence go on."""
        try:
            self._drain()
            problem = ""
        except EmaError as error:
            problem = str(error)
        seen = self._observe()
        if problem:
            self._perform(self._sequence.fail(problem, seen))
        self._perform(self._sequence.step(seen))
        while self._waiting and not self._interlock.is_undecided(
            time.monotonic(), self._waiting[0].asked
        ):
            request = self._waiting.pop(0)
            if self._sequence.stage is Stage.IDLE and self._request is None:
                self._request, self._foreign = request, False
                self._began = time.monotonic()
                self._perform(self._sequence.start(self._observe()))
            else:
                request.ended.set_result(RUNNING)

    def _drain(self) -> None:
        self._recorder.begin_turn()
        for topic, subscription in self._polled.items():
            taken = take_all(subscription)
            for data, received, sent, _ in in_order(taken) if topic == SAMPLES else taken:
                if topic == SAMPLES:
                    self._last_block = time.monotonic()
                elif topic == DIAGNOSTICS:
                    self._take_diagnostics(data)
                    continue
                elif topic == WEIGHT_ON_WHEELS:
                    message = deserialize_message(data, Bool)
                    transit = (time.time_ns() - sent) / 1e9
                    self._interlock.update(message.data, time.monotonic(), transit)
                elif topic == COMMAND:
                    stamp = stamp_of(deserialize_message(data, JointTrajectory))
                    self._foreign = self._foreign or stamp not in self._sent
                self._recorder.take(topic, data, received, sent)

    def _take_diagnostics(self, data: bytes) -> None:
        found = find_actuator(deserialize_message(data, DiagnosticArray))
        if found is not None:
            self._actuator, serial = found
            self._actuator_heard = time.monotonic()
            self._serial = self._serial or serial

    def _observe(self) -> Observation:
        now = time.monotonic()
        finding = self._sequence.stage is Stage.FINDING
        silent = finding and now - self._actuator_heard > ACTUATOR_TIMEOUT
        return Observation(
            now=now, stamp=time.time_ns(), interlock=self._interlock.reason(now, self._began),
            missing=self._missing() if finding else "",
            actuator=None if silent else self._actuator,
            samples_received=self._recorder.samples_received,
            last_sample=self._recorder.last_sample, last_block=self._last_block,
            foreign_command=self._foreign, stop=bool(self._stop),
        )

    def _missing(self) -> str:
        """Return what of the graph is missing or in the way."""
        publishers = self._polled[SAMPLES].get_publisher_count()
        if publishers != 1:
            return f"{publishers} nodes publish {SAMPLES}, expected one actuator"
        if self._command.get_subscription_count() < 1:
            return f"no actuator listens to {COMMAND}"
        if self.count_services(SELF_TEST_SERVICE) > 1:
            return f"another monitor offers {SELF_TEST_SERVICE} on this domain"
        return ""

    def _perform(self, actions: Sequence[Action]) -> None:
        for action in actions:
            try:
                self._do(action)
            except EmaError as error:
                self._perform(self._sequence.fail(str(error), self._observe()))
                return
        if actions:
            self._publish_status()

    def _do(self, action: Action) -> None:
        if isinstance(action, SendCommand):
            self._recorder.reset_count()
            self._sent.add(action.stamp)
            self._command.publish(encode_command(action.profile, action.stamp))
        elif isinstance(action, OpenRecord):
            path = new_bag_path(
                self._directory, self._serial, action.stamp, action.profile.name
            )
            self._recorder.open(path, action.profile, self._serial or "unknown", action.stamp)
        elif isinstance(action, CloseRecord):
            self._close(action)
        elif isinstance(action, Finish):
            self._finish(action.reason)

    def _close(self, action: CloseRecord) -> None:
        """Check the record, close it, announce it if it is complete."""
        results: list[CheckResult] = []
        if action.status == "complete":
            results = [
                check_counters(action.samples_published, self._recorder.samples_recorded),
                *check_record(
                    self._recorder.record(self._sequence.profile), self._described
                ),
            ]
        path = self._recorder.close(action.status, action.start_time)
        if path is None:
            return
        closed = time.time_ns()
        if self._request is not None:
            self._request.passed = bool(results) and worst(results) < Level.ERROR
            self._request.statuses = [
                level_status(
                    "ema_monitor: record", Level.OK if results else Level.ERROR, action.status,
                    {"path": str(path.resolve()), "status": action.status,
                     "closed": str(closed)},
                ),
                *(check_status(result) for result in results),
            ]
        if action.status == "complete":
            self._record.publish(String(data=str(path.resolve())))
        self.get_logger().info(f"{path}: {action.status}")

    def _finish(self, reason: str) -> None:
        self._last_reason = reason or "the last test ran to its end"
        self._failed = bool(reason)
        request, self._request, self._began = self._request, None, None
        if request is not None:
            request.passed = request.passed and not reason
            request.ended.set_result(reason)

    def _publish_status(self) -> None:
        stage = self._sequence.stage
        idle = stage is Stage.IDLE
        array = DiagnosticArray(status=[level_status(
            "ema_monitor: test", Level.WARN if idle and self._failed else Level.OK,
            f"idle; {self._last_reason}" if idle else stage.value,
            {"stage": stage.name.lower(),
             "interlock": self._interlock.reason(time.monotonic(), self._began) or "closed",
             "samples_recorded": str(self._recorder.samples_recorded),
             "clock_step_s": f"{self._recorder.clock_step:.3f}"},
            self._serial,
        )])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def shut_down(self) -> None:
        """End a test that runs: its record closed, the surface sent back, all callers answered."""
        was_running = self._sequence.stage is not Stage.IDLE
        while self._sequence.stage is not Stage.IDLE:
            self._perform(self._sequence.step(self._observe()))
        for request in self._waiting:
            request.ended.set_result("refused: the monitor ends")
        self._waiting.clear()
        end = time.monotonic() + SHUT_DOWN
        while self.executor is not None and self._callers and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=POLL_PERIOD)
        if was_running:
            self._command.wait_for_all_acked(Duration(seconds=1))


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    sys.exit(run_node(rclpy, MonitorNode, args))


if __name__ == "__main__":
    main()
