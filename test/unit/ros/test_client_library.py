"""What is used of the client library beyond its public interface: in one file, and still there."""

import inspect
import re
import types

import pytest
import rclpy
from rclpy.callback_groups import CallbackGroup
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from std_msgs.msg import String

from ema_ros.messages import DiagnosticsPublisher, PolledGroup, monitors, take_all
from ema_ros.process import spun

PRIVATE = re.compile(r"rclpy_implementation|take_message|\.handle\b|_rclpy|CallbackGroup\)")
HERE = "ema_ros/messages.py"


def test_no_other_file_uses_it(repository):
    users = {str(path.relative_to(repository)) for path in repository.glob("ema_*/**/*.py")
             if PRIVATE.search(path.read_text(encoding="utf-8"))}
    assert users == {HERE}


def test_it_is_as_we_know_it():
    assert issubclass(rclpy_implementation.RCLError, RuntimeError)
    names = {name for name, _ in inspect.getmembers(CallbackGroup, inspect.isfunction)}
    assert {"can_execute", "beginning_execution", "ending_execution"} <= names
    assert "can_execute" in inspect.getsource(Executor)


def test_diagnostics_tell_who_is_new(monkeypatch):
    counts = iter([0, 1, 1, 0, 2])
    publisher = types.SimpleNamespace(get_subscription_count=lambda: next(counts))
    monkeypatch.setattr("ema_ros.messages.make_publisher", lambda *_: publisher)
    diagnostics = DiagnosticsPublisher(None)
    assert [diagnostics.has_new_reader() for _ in range(5)] == [False, True, False, False, True]


def test_a_polled_subscription_wakes_nobody_and_gives_all_with_its_stamps(ros_domain):
    woken, found = [], []
    with spun(rclpy, lambda context: [rclpy.create_node("pinned", context=context)]) as (node,):
        polled = node.create_subscription(
            String, "text", woken.append, 10, raw=True, callback_group=PolledGroup())
        publisher = node.create_publisher(String, "text", 10)
        for number in range(200):
            if publisher.get_subscription_count() and number % 20 == 0:
                publisher.publish(String(data=str(number)))
            node.executor.spin_once(timeout_sec=0.01)
            found += take_all(polled)
    assert woken == []
    assert len(found) >= 5
    assert all(0 < taken.sent <= taken.received for taken in found)
    numbers = [taken.sequence for taken in found]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


@pytest.mark.parametrize(("others", "found"), [
    ([], []), (["ema_monitor"], ["/left/ema_monitor/self_test"]),
    (["second", "recorder"], ["/left/second/self_test"]),
])
def test_a_monitor_is_found_whatever_its_node_is_called(others, found):
    publisher = types.SimpleNamespace
    node = types.SimpleNamespace(
        resolve_service_name=lambda _: "/left/ema_monitor/self_test",
        resolve_topic_name=lambda name: f"/left/{name}",
        get_publishers_info_by_topic=lambda name: [
            publisher(node_namespace="/left", node_name=other) for other in others
            if name == "/left/ema/bit/record"],
        count_services=lambda name: name.split("/")[2] in others and "recorder" not in name)
    assert monitors(node) == found
