"""The node `ema_monitor`: the service that runs and records the built-in test."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import rclpy
import rclpy.executors
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.srv import SelfTest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from std_msgs.msg import Bool, Header, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from ema_monitor.messages import (
    ACTUATOR_STATUS,
    READ,
    Request,
    VerdictKeeper,
    fill_response,
    find_actuator,
    level_status,
    record_statuses,
    refuse,
    what_is_missing,
)
from ema_monitor.observation import ACTUATOR_TIMEOUT, ActuatorStatus, Observation
from ema_monitor.recorder import BitRecorder, new_bag_path
from ema_monitor.sequence import (
    ENDING,
    Action,
    CloseRecord,
    Finish,
    OpenRecord,
    SendCommand,
    Stage,
    TestSequence,
)
from ema_monitor.settings import SPECS
from ema_record.actuator import load_actuator
from ema_record.checks.live import CheckResult, Level, check_counters, check_record, worst
from ema_record.errors import EmaError
from ema_record.profile import load_profile
from ema_record.wire.topics import (
    BIT_RECORD,
    COMMAND,
    DEADMAN,
    DIAGNOSTICS,
    SAMPLES,
    WEIGHT_ON_WHEELS,
)
from ema_record.wire.trajectory import encode_command
from ema_record.wire.types import stamp_of
from ema_ros.ema_node import DIAGNOSTICS_PERIOD, EmaNode, declare_parameters
from ema_ros.interlock import Interlock
from ema_ros.messages import (
    DiagnosticsPublisher,
    PolledGroup,
    make_polled_subscription,
    make_publisher,
    make_timer,
    namespace_of,
    read_message,
    set_period,
    stamp_message,
    status_name,
    take_all,
    unheard,
)
from ema_ros.process import SHUT_DOWN, StopSignal, run_node

POLL_PERIOD = 0.02
POLL_PERIODS = {Stage.IDLE: 0.05, Stage.TESTING: 0.025}
"""Where another is enough: samples wait, and the actuator looks at the interlock by itself."""
SIGN_PERIOD = 0.05
RUNNING = "refused: a test is running already: wait for its end"


class MonitorNode(EmaNode):
    """Runs the built-in test on request; all of it happens in one timer, the poll."""

    name = "ema_monitor"

    def __init__(self, stop: StopSignal) -> None:
        super().__init__(stop)
        self._values = declare_parameters(self, SPECS)
        self._serial = str(self._values["serial_number"])
        self._namespace = namespace_of(self)
        self._request: Request | None = None
        self._waiting: list[Request] = []
        self._callers = 0

    def configure(self) -> None:
        """Load the test, and make the publishers."""
        values = self._values
        self._described = load_actuator(str(values["model_file"]) or None)
        self._sequence = TestSequence(
            load_profile(str(values["profile"])), self._described,
            stream_timeout=float(values["stream_timeout"]),
            test_timeout=float(values["test_timeout"]),
        )
        self._command = make_publisher(self, COMMAND)
        self._deadman = make_publisher(self, DEADMAN)
        self._record = make_publisher(self, BIT_RECORD)
        self._diagnostics = DiagnosticsPublisher(self)

    def activate(self) -> None:
        """Look for another monitor, then listen and offer the services."""
        self.refuse_another()
        self._interlock = Interlock(float(self._values["weight_on_wheels_timeout"]))
        self._recorder = BitRecorder(self._namespace)
        self._actuator: ActuatorStatus | None = None
        self._actuator_heard, self._last_block = 0.0, -1.0
        self._reported: dict[str, float] = {}  # serial numbers, and when each was heard
        self._began: float | None = None
        self._sent: set[int] = set()
        self._last_sent, self._next_sign = 0, 0.0
        self._foreign = self._abort = self._leaving = False
        self._last_reason, self._failed = "no test yet", False
        group = PolledGroup()
        self._polled = {
            topic: make_polled_subscription(self, topic, group) for topic in READ
        }
        self._keeper = VerdictKeeper(self, group, wanted=bool(self._values["record_verdict"]))
        self._timer = make_timer(self, POLL_PERIODS[Stage.IDLE], self._poll)
        self.while_active(
            *self._polled.values(), self._keeper.subscription,
            self._timer,
            make_timer(self, DIAGNOSTICS_PERIOD, self._publish_status),
            self.create_service(Trigger, "~/abort", self._on_abort),
            self.create_service(
                SelfTest, "~/self_test", self._self_test, callback_group=ReentrantCallbackGroup()
            ),
        )
        self.get_logger().info("ready")

    def deactivate(self) -> None:
        """End a test that runs: its record is closed, all callers are answered."""
        self._leaving = True
        self._end("refused: the monitor is deactivated")

    def _on_abort(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Stop the surface, and end the test that runs or waits for its begin."""
        stage = self._sequence.stage
        waited = refuse(self._waiting, "refused: the test was asked to end")
        self._abort = stage is not Stage.IDLE
        response.success = self._abort or waited
        what = stage.value if self._abort else "before its begin"
        response.message = f"aborting: {what}" if response.success else "no test runs"
        self._poll()
        return response

    async def _self_test(self, _: SelfTest.Request, response: SelfTest.Response
                         ) -> SelfTest.Response:
        """Wait for the end of the test without holding up the poll, however many callers wait."""
        request = Request()
        self._waiting.append(request)
        self._callers += 1
        reason = await request.ended
        self._callers -= 1
        return fill_response(response, self._serial, request, reason)

    def _poll(self) -> None:
        """Take what has arrived, then let the sequence go on."""
        problem, seen = self._drain(), self._observe()
        if problem and self._sequence.stage not in ENDING:
            self._perform(self._sequence.fail(problem, seen))
        self._perform(self._sequence.step(seen))
        while self._waiting and not self._interlock.is_undecided(
                time.monotonic(), self._waiting[0].asked):
            request = self._waiting.pop(0)
            if self._sequence.stage is Stage.IDLE and self._request is None:
                self._request, self._foreign, self._abort = request, False, False
                self._began = time.monotonic()
                self._perform(self._sequence.start(self._observe(begins=True)))
            else:
                request.ended.set_result(RUNNING)
        set_period(self._timer, POLL_PERIODS.get(self._sequence.stage, POLL_PERIOD))
        self._keeper.poll()

    def _send_sign_of_life(self) -> None:
        now = time.monotonic()
        if self._sequence.stage not in (Stage.IDLE, Stage.FINDING) and now >= self._next_sign:
            self._next_sign = now + SIGN_PERIOD
            self._deadman.publish(Header(stamp=stamp_message(self._last_sent)))

    def _drain(self) -> str:
        """Take all that waits; return what is wrong with the first message that cannot be kept."""
        self._recorder.clock.look()
        problem = ""
        for topic, subscription in self._polled.items():
            self._send_sign_of_life()
            taken = take_all(subscription)
            if topic == SAMPLES:  # as sent: they wait by a clock that may have been set back
                taken.sort(key=lambda message: message.sequence)
            for data, received, sent, _ in taken:
                if topic == SAMPLES:
                    self._send_sign_of_life()  # a backlog on a machine that is loaded takes long
                    self._last_block = time.monotonic()
                elif topic == DIAGNOSTICS:
                    problem = self._take_diagnostics(data) or problem
                    continue
                elif topic == WEIGHT_ON_WHEELS:
                    message = read_message(data, Bool) or Bool()  # in doubt it is off
                    transit = (time.time_ns() - sent) / 1e9
                    self._interlock.update(message.data, time.monotonic(), transit)
                elif topic == COMMAND:
                    stamp = stamp_of(read_message(data, JointTrajectory) or JointTrajectory())
                    self._foreign = self._foreign or stamp not in self._sent
                try:
                    self._recorder.take(topic, data, received, sent)
                except EmaError as error:
                    problem = problem or str(error)
        return problem

    def _take_diagnostics(self, data: bytes) -> str:
        if ACTUATOR_STATUS.encode() not in data:
            return ""
        found = find_actuator(read_message(data, DiagnosticArray), self._namespace)
        if found is not None:
            self._actuator, serial = found
            self._actuator_heard = time.monotonic()
            self._reported = {**dict([*self._reported.items()][-9:]), serial: self._actuator_heard}
            before, self._serial = self._serial, str(self._values["serial_number"]) or serial
            changed = before and self._serial not in ("", before)
            if changed and self._sequence.stage is not Stage.FINDING:
                return f"the actuator was {before} and is {self._serial} now"
        return ""

    def _observe(self, begins: bool = False) -> Observation:
        now = time.monotonic()
        finding = begins or self._sequence.stage is Stage.FINDING
        silent = finding and now - self._actuator_heard > ACTUATOR_TIMEOUT
        interlock = self._interlock.reason(now, self._began)
        if interlock:
            interlock += unheard(self, self._polled[WEIGHT_ON_WHEELS])
        recent = [s for s, at in self._reported.items() if s and now - at <= ACTUATOR_TIMEOUT]
        return Observation(
            now=now, stamp=time.time_ns(), interlock=interlock,
            missing=what_is_missing(self, self._polled[SAMPLES], self._command,
                                    recent) if finding else "",
            actuator=None if silent else self._actuator, actuator_heard=self._actuator_heard,
            samples_received=self._recorder.samples_received,
            last_sample=self._recorder.last_sample,
            last_position=self._recorder.last_position, last_block=self._last_block,
            foreign_command=self._foreign, abort=self._abort,
            stop=bool(self._stop) or self._leaving,
        )

    def _perform(self, actions: Sequence[Action]) -> None:
        for action in actions:
            try:
                self._do(action)
            except EmaError as error:
                instead = self._sequence.fail(str(error), self._observe())
                if instead:
                    self._perform(instead)
                    return
        if actions:
            self._publish_status()

    def _do(self, action: Action) -> None:
        if isinstance(action, SendCommand):
            self._recorder.reset_count()
            self._sent.add(action.stamp)
            self._last_sent, self._next_sign = action.stamp, 0.0
            self._command.publish(encode_command(action.profile, action.stamp))
        elif isinstance(action, OpenRecord):
            path = new_bag_path(
                Path(str(self._values["output_directory"])), self._serial, action.stamp,
                action.profile.name, self._namespace.removeprefix("/"))
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
                *check_record(self._recorder.record(self._sequence.profile), self._described),
            ]
        path = self._recorder.close(action.status, action.start_time)
        if path is None:
            return
        if self._request is not None:
            self._request.passed = bool(results) and worst(results) < Level.ERROR
            self._request.statuses = record_statuses(path, action.status, time.time_ns(), results)
        if action.status == "complete":
            self._keeper.expect(path)
            self._record.publish(String(data=str(path.resolve())))
        self.get_logger().info(f"{path}: {action.status}")

    def _finish(self, reason: str) -> None:
        self._last_reason, self._failed = reason or "the last test ran to its end", bool(reason)
        if reason:
            self.get_logger().warning(f"test {reason}")
        request, self._request, self._began = self._request, None, None
        if request is not None:
            request.passed = request.passed and not reason
            request.ended.set_result(reason)

    def _publish_status(self) -> None:
        stage = self._sequence.stage
        idle = stage is Stage.IDLE
        self._diagnostics.publish(level_status(
            status_name(self, "test"), Level.WARN if idle and self._failed else Level.OK,
            f"idle; {self._last_reason}" if idle else stage.value,
            {"stage": stage.name.lower(),
             "interlock": self._interlock.reason(time.monotonic(), self._began) or "closed",
             "samples_recorded": str(self._recorder.samples_recorded),
             "clock_step_s": f"{self._recorder.clock.shift:.3f}"},
            self._serial,
        ))

    def shut_down(self) -> None:
        """End a test that runs: its record closed, the surface sent back, all callers answered."""
        if self.is_active:
            self._end("refused: the monitor ends")
            self._keeper.wait()

    def _end(self, refusal: str) -> None:
        """End a test that runs; those who still wait for one get the refusal."""
        was_running = self._sequence.stage is not Stage.IDLE
        while self._sequence.stage is not Stage.IDLE:
            self._perform(self._sequence.step(self._observe()))
        refuse(self._waiting, refusal)
        end = time.monotonic() + SHUT_DOWN
        while self.executor is not None and self._callers and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=POLL_PERIOD)
        if was_running:
            self._command.wait_for_all_acked(Duration(seconds=1))


def main() -> None:
    """Run the node."""
    sys.exit(run_node(rclpy, MonitorNode.started))


if __name__ == "__main__":
    main()
