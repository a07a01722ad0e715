"""The SROS 2 policy is what the nodes do on a real graph; only the monitor may command."""

import contextlib
import signal
import xml.etree.ElementTree as ET

import pytest
from ros_processes import MONITOR, PROGNOSTICS, SIMULATOR, START_TIMEOUT

from ema_record.kit import share_path
from ema_record.wire.topics import BIT_RECORD, COMMAND, TOPICS, WEIGHT_ON_WHEELS

NODES = {"ema_prognostics": PROGNOSTICS, "ema_sim": SIMULATOR, "ema_monitor": MONITOR}


@pytest.fixture(scope="module")
def policy():
    """Return what each node may do: {(node, "publish" | "subscribe" | "reply"): names}."""
    allowed = {}
    for profile in ET.parse(share_path("config/sros2/policy.xml")).getroot().iter("profile"):
        node = profile.get("node")
        for group in profile:
            for action in ("publish", "subscribe", "reply", "request"):
                if group.get(action) == "ALLOW":
                    allowed[node, action] = {
                        (name.text or "").replace("~", f"/{node}") for name in group}
    return allowed


def test_one_node_may_command_and_one_may_close_the_interlock(policy):
    def publishers(topic):
        return [node for (node, action), names in policy.items()
                if action == "publish" and topic in names]

    assert publishers(COMMAND) == ["ema_monitor"]
    assert publishers(WEIGHT_ON_WHEELS) == ["aircraft"]
    assert all(publishers(topic) for topic in TOPICS)


@pytest.mark.slow
def test_the_nodes_do_what_they_may_and_no_more(policy, nodes, watcher):
    """The prognostics listen to the topics while there is no monitor."""
    graph = watcher.node

    def seen(name):
        return {
            action: {topic for topic, _ in ask(name, "/")} for action, ask in (
                ("publish", graph.get_publisher_names_and_types_by_node),
                ("subscribe", graph.get_subscriber_names_and_types_by_node),
                ("reply", graph.get_service_names_and_types_by_node))
        }

    for name, module in NODES.items():
        may = {action: policy[name, action] for action in ("publish", "subscribe", "reply")}
        nodes.start(module)
        watcher.wait(lambda name=name: name in graph.get_node_names(), START_TIMEOUT, module)
        with contextlib.suppress(AssertionError):  # the comparison says more
            watcher.wait(lambda name=name, may=may: seen(name) == may, 60.0, module)
        assert seen(name) == may, name
    listens = policy["ema_prognostics", "subscribe"]
    watcher.wait(lambda: seen("ema_prognostics")["subscribe"] == {BIT_RECORD}, what="silence")
    nodes.last[MONITOR].send_signal(signal.SIGINT)
    watcher.wait(lambda: seen("ema_prognostics")["subscribe"] == listens, what="live topics")
