"""The node `ema_replay`: publishes the messages of a bag."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import rclpy
import rclpy.executors
from rclpy.duration import Duration
from rclpy.node import Node

from ema_record.errors import TestRefusedError
from ema_record.wire.topics import COMMAND, SAMPLES
from ema_ros.ema_node import LOOK_FOR_OTHERS
from ema_ros.messages import make_publisher, try_publish
from ema_ros.process import spun
from ema_ros.replay_bag import ReplayMessage

NODE_NAME = "ema_replay"
STEP = 0.01
ACKNOWLEDGE_TIMEOUT = 10.0


class ReplayNode(Node):
    """Publishers of all topics of a bag."""

    def __init__(self, topics: Sequence[str], context: rclpy.Context) -> None:
        super().__init__(NODE_NAME, context=context)
        self._outputs = {topic: make_publisher(self, topic) for topic in topics}
        self.counts = dict.fromkeys(topics, 0)

    def matched(self) -> bool:
        """Whether somebody listens to the samples, and all who listen are connected."""
        return self._outputs[SAMPLES].get_subscription_count() > 0 and all(
            publisher.get_subscription_count() >= self.count_subscribers(topic)
            for topic, publisher in self._outputs.items()
        )

    def refuse_actuator(self) -> None:
        """Raise TestRefusedError if an actuator would execute the command of the bag."""
        if self.count_publishers(SAMPLES) > 1:
            raise TestRefusedError(
                f"another node publishes {SAMPLES}: replay in a domain without an actuator, "
                f"which would obey {COMMAND}"
            )

    def publish(self, message: ReplayMessage) -> None:
        """Publish one message; slow readers are waited for."""
        while not try_publish(self._outputs[message.topic], message.data):
            if not self.context.ok():
                raise TestRefusedError(f"{message.topic}: the middleware has ended")
        self.counts[message.topic] += 1

    def wait_for_acknowledgement(self) -> None:
        """Wait until every reader has every message."""
        for topic, publisher in self._outputs.items():
            if not publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIMEOUT)):
                raise TestRefusedError(
                    f"{topic}: not acknowledged after {ACKNOWLEDGE_TIMEOUT:g} s: "
                    "a subscriber has stopped"
                )


def play(
    messages: Sequence[ReplayMessage], *, rate: float, wait: float, show: Callable[[float], None]
) -> dict[str, int]:
    """Publish messages in their time and return how many of each topic.

    Parameters
    ----------
    messages : in order of time.
    rate : speed, 1 for the original timing.
    wait : longest wait for a subscriber to the samples (s).
    show : is told how much is done (s).
    """
    topics = list(dict.fromkeys(message.topic for message in messages))
    with spun(rclpy, lambda context: [ReplayNode(topics, context)]) as (node,):
        begin = time.monotonic()
        while not node.matched() or time.monotonic() - begin < LOOK_FOR_OTHERS:
            if time.monotonic() - begin > max(wait, LOOK_FOR_OTHERS):
                raise TestRefusedError(
                    f"nobody listens to {SAMPLES} after {wait:g} s: start a subscriber in this "
                    "ROS_DOMAIN_ID"
                )
            time.sleep(STEP)
        node.refuse_actuator()
        begin = time.monotonic()
        for message in messages:
            due = message.time / rate
            while (ahead := begin + due - time.monotonic()) > 0.0:
                time.sleep(min(ahead, 0.1))
                show(time.monotonic() - begin)
            node.publish(message)
        node.wait_for_acknowledgement()
        return dict(node.counts)
