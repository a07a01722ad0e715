"""The SROS 2 policy is what the nodes do on a real graph; only the monitor may command."""

import xml.etree.ElementTree as ET

import pytest
from ros_processes import MONITOR, PROGNOSTICS, SIMULATOR

from ema_record.kit import share_path
from ema_record.wire.topics import COMMAND, TOPICS, WEIGHT_ON_WHEELS

NODES = ("ema_sim", "ema_monitor", "ema_prognostics")


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


def test_the_nodes_do_what_they_may_and_no_more(policy, nodes, watcher):
    for module in (SIMULATOR, MONITOR, PROGNOSTICS):
        nodes.start(module)
    watcher.wait_for_simulator()
    watcher.wait_for_monitor()
    watcher.wait_for_prognostics()
    graph = watcher.node
    for name in NODES:
        seen = {
            "publish": graph.get_publisher_names_and_types_by_node(name, "/"),
            "subscribe": graph.get_subscriber_names_and_types_by_node(name, "/"),
            "reply": graph.get_service_names_and_types_by_node(name, "/"),
        }
        for action, found in seen.items():
            assert {topic for topic, _ in found} == policy[name, action], (name, action)
