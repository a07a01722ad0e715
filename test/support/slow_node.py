"""A reader of `/ema/samples` that takes two messages a second, until it is ended."""

from __future__ import annotations

import time

import rclpy

from ema_record.wire.topics import SAMPLES
from ema_ros.messages import PolledGroup, make_polled_subscription
from ema_ros.process import QUIET, prepare_environment


def main() -> None:
    """Read slowly."""
    prepare_environment()
    rclpy.init(args=QUIET)
    node = rclpy.create_node("slow_reader")
    subscription = make_polled_subscription(node, SAMPLES, PolledGroup())
    while rclpy.ok():
        time.sleep(0.5)
        with subscription.handle:
            subscription.handle.take_message(subscription.msg_type, True)


if __name__ == "__main__":
    main()
