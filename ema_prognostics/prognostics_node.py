"""The node `ema_prognostics`: a verdict for every record that is announced or seen."""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from pathlib import Path

import rclpy
import rclpy.executors
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.subscription import Subscription
from std_msgs.msg import String

from ema_prognostics.node.assembler import TOPICS, RecordAssembler
from ema_prognostics.node.messages import fault_statuses, severity_message, verdict_status
from ema_prognostics.verdict.contract import trace_of, verdict_object
from ema_prognostics.verdict.judge import Judge
from ema_prognostics.verdict.report import verdict_of_error
from ema_prognostics.verdict.verdict import Judged
from ema_record.bag.container import METADATA_FILE
from ema_record.bag.read import read_bag
from ema_record.errors import EmaError, InvalidRecordError, RecordError, UsageError
from ema_record.wire.topics import BIT_RECORD, COMMAND, SEVERITY, VERDICT
from ema_ros.ema_node import DIAGNOSTICS_PERIOD, EmaNode, declare_parameters
from ema_ros.messages import (
    OK,
    DiagnosticsPublisher,
    diagnostic_status,
    make_publisher,
    make_subscription,
    make_timer,
    namespace_of,
    status_name,
    take_all,
)
from ema_ros.parameters import KIT, ParameterSpec
from ema_ros.process import StopSignal, report, run_node

POLL_PERIOD = 0.1
NICE = 10
"""By how much it stands behind the nodes that must not be late, where they share a core."""
REMEMBERED = 100
"""Announced paths that are not opened again; one that was forgotten is diagnosed anew."""
LONGEST_PATH = 4096
NOT_A_BAG = "no bag that can be read: 'ema check', where it was recorded, says more"
"""All that is published of an announced path without a record, whatever there is instead."""
LIVE = "live"
"""What stands for the bag of a record that was seen on the topics."""
SPECS = (
    KIT,
    ParameterSpec(
        name="record", default="", read_only=True,
        text="bag to diagnose at the start; empty: wait for /ema/bit/record",
    ),
    ParameterSpec(
        name="model_file", default="", read_only=True,
        text="model of the cascade; empty: the kit's",
    ),
    ParameterSpec(
        name="baseline", default="", read_only=True,
        text="bag of a healthy test of the same actuator, to compare with; empty: none",
    ),
)


class PrognosticsNode(EmaNode):
    """Diagnoses each announced record once, and what is replayed onto the topics."""

    name = "ema_prognostics"

    def __init__(self, stop: StopSignal) -> None:
        super().__init__(stop)
        self._values = declare_parameters(self, SPECS)
        self._done: deque[str] = deque(maxlen=REMEMBERED)
        self._records = 0
        self._state = "waiting for a record"
        self._statuses: list[DiagnosticStatus] = []

    def configure(self) -> None:
        """Load the model, and make the publishers."""
        values = self._values
        self._judge = Judge(str(values["model_file"]) or None, str(values["baseline"]) or None)
        self._trace = trace_of(self._judge.model_sha256)
        self._verdict = make_publisher(self, VERDICT)
        self._severity = make_publisher(self, SEVERITY)
        self._diagnostics = DiagnosticsPublisher(self)

    def activate(self) -> None:
        """Listen."""
        self._assembler = RecordAssembler()
        self._live: dict[str, Subscription] = {}
        self._announced = make_subscription(self, BIT_RECORD, self._on_record)
        self._listen_unless_recorded()
        self.while_active(
            self._announced,
            make_timer(self, POLL_PERIOD, self._poll),
            make_timer(self, DIAGNOSTICS_PERIOD, self._publish_status),
        )
        self.get_logger().info("ready")
        if self._values["record"]:
            path = str(Path(str(self._values["record"])).resolve())
            self._done.append(path)
            self._publish(self._judge.of_bag(path))

    def deactivate(self) -> None:
        """Listen to the topics no more."""
        self._stop_listening()

    def _listen_unless_recorded(self) -> None:
        """Listen to the topics while nobody announces records: it costs all who send, too."""
        recorded = self._announced.get_publisher_count() > 0
        if recorded:
            self._stop_listening()
        elif not self._live:
            for topic in TOPICS:
                self._listen(topic)

    def _stop_listening(self) -> None:
        for subscription in self._live.values():
            self.destroy_subscription(subscription)
        self._live.clear()

    def _listen(self, topic: str) -> None:
        """Hand the serialised messages of a topic to the assembler, all that wait at once."""

        def callback(data: bytes) -> None:
            if topic == COMMAND:
                self._judge_what_was_seen()  # the next command would take its place
            for message in (data, *(taken.data for taken in take_all(self._live[topic]))):
                try:
                    self._assembler.take(topic, message, time.monotonic())
                except EmaError as error:
                    self.get_logger().warning(str(error))

        self._live[topic] = make_subscription(self, topic, callback, raw=True)

    def _on_record(self, message: String) -> None:
        """Diagnose an announced bag, once it can be read.

        Anybody on the domain may announce: nothing but a bag is opened, and what is wrong with
        it is written to stderr alone, lest the verdict tell which files exist.
        """
        path = message.data
        if path in self._done or len(path) > LONGEST_PATH:
            return
        try:
            if not (path.startswith("/") and Path(path, METADATA_FILE).is_file()):
                raise InvalidRecordError(NOT_A_BAG)
            record = read_bag(path)
        except (RecordError, UsageError, OSError) as error:
            report(f"announced {path!r}: {error}")  # it may be announced again once it is whole
            self._publish(Judged(verdict_of_error(InvalidRecordError(NOT_A_BAG), path)))
            return
        self._done.append(path)
        self._publish(self._judge.of_record(record, path))

    def _poll(self) -> None:
        """Listen where nobody announces records, and diagnose what was seen."""
        self._listen_unless_recorded()
        self._judge_what_was_seen()

    def _judge_what_was_seen(self) -> None:
        """Diagnose what was seen on the topics, unless a recorder announces its records."""
        try:
            record = self._assembler.finished(time.monotonic())
        except EmaError as error:
            self.get_logger().warning(str(error))
            return
        if record is not None and self._announced.get_publisher_count() == 0:
            self._publish(self._judge.of_record(record, LIVE))

    def _publish(self, judged: Judged) -> None:
        # The verdict becomes part of the record, so it cannot hold its hash.
        verdict = verdict_object(judged, self._trace, record_sha256="")
        namespace = namespace_of(self)
        status = verdict_status(status_name(self, "verdict"), verdict, judged)
        self._statuses = [status, *fault_statuses(
            f"{namespace}/" if namespace else "", verdict, judged.serial_number)]
        self._verdict.publish(status)
        self._severity.publish(severity_message(verdict))
        self._records += 1
        self._state = f"diagnosed {verdict['bag']}"
        self._publish_status()
        self.get_logger().info(f"{verdict['bag']}: {status.message}")

    def _publish_status(self) -> None:
        self._diagnostics.publish(diagnostic_status(
            status_name(self, "node"), OK, self._state, {"records": str(self._records)}
        ), *self._statuses)


def main() -> None:
    """Run the node; what records and commands goes before."""
    os.nice(NICE)
    sys.exit(run_node(rclpy, PrognosticsNode.started))


if __name__ == "__main__":
    main()
