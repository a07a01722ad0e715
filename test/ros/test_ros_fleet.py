"""Several actuators on one domain: each in the namespace of its name."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from ros_processes import MONITOR, SIMULATOR, ema

from ema_record.bag.read import read_bag
from ema_record.wire.topics import COMMAND, SAMPLES, VERDICT
from ema_ros.messages import make_publisher

pytestmark = pytest.mark.slow

SHORT = "right_aileron:turn_short.fraction=0.1"


def test_a_namespace_with_a_slash_at_its_end_is_told(ros_domain):
    run = subprocess.run(
        [sys.executable, "-m", MONITOR, "--ros-args", "-r", "__ns:=/left/"],
        capture_output=True, text=True, timeout=60.0, check=False)
    assert run.returncode == 2 and "Traceback" not in run.stderr, run.stderr
    assert "without a slash at its end" in run.stderr.splitlines()[-1]


def fleet(tmp_path, *arguments):
    """Test actuators by name; return the exit status and their results by name."""
    run = ema("bit", "--profile", "step", "--json", "--out", tmp_path / "records", *arguments)
    assert "Traceback" not in run.stderr
    results = [json.loads(line) for line in run.stdout.splitlines()]
    return run.returncode, {result["actuator"]: result for result in results}, run.stderr


@pytest.mark.parametrize("side_by_side", [1, 2])
def test_two_actuators_are_tested_and_nothing_crosses(tmp_path, side_by_side):
    status, found, errors = fleet(
        tmp_path, "--actuators", "left_aileron,right_aileron", "--effect", SHORT,
        "--side-by-side", side_by_side)
    assert status == 1, errors
    assert list(found) == ["left_aileron", "right_aileron"]
    left, right = found["left_aileron"]["verdict"], found["right_aileron"]["verdict"]
    assert (left["verdict"], right["fault_class"]) == ("healthy", "turn_short")
    for number, (name, result) in enumerate(found.items()):
        bag = Path(result["record"])
        assert result["verdict"]["actuator"] == name
        assert result["verdict"]["bag"] == str(bag)
        assert bag.name.startswith(f"{name}_SIM-0000-{number + 1}_")
        record = read_bag(bag)
        assert (len(record), record.provenance.name) == (9000, name)
        assert f"name: /{name}{VERDICT}" in (bag / "metadata.yaml").read_text()


def test_a_name_that_is_none_and_an_effect_of_nobody_are_wrong_use(tmp_path):
    for arguments, hint in (
        (("--actuators", "left aileron"), "not the name of a ROS namespace"),
        (("--actuators", "a,a"), "give each name once"),
        (("--actuators", "left", "--effect", SHORT), "unknown actuator 'right_aileron'"),
        (("--no-simulator", "--effect", "friction.factor=2"), "leave out --no-simulator"),
    ):
        run = ema("bit", "--out", tmp_path / "records", *arguments)
        assert (run.returncode, run.stderr.count("\n")) == (2, 1), run.stderr
        assert hint in run.stderr


def leave_the_record_alone(watcher, path):
    """Give a verdict on a record; without `record_verdict` it stays as it is."""
    before = {file.name: file.read_bytes() for file in Path(path).iterdir()}
    publisher = make_publisher(watcher.node, VERDICT)
    watcher.wait(lambda: publisher.get_subscription_count() > 0, what="a reader of verdicts")
    publisher.publish(DiagnosticStatus(values=[KeyValue(key="bag", value=path)]))
    watcher.spin_for(0.5)
    watcher.node.destroy_publisher(publisher)
    assert {file.name: file.read_bytes() for file in Path(path).iterdir()} == before


def test_a_node_told_to_wait_is_configured_and_activated_from_outside(nodes, watcher, tmp_path):
    nodes.start(SIMULATOR)
    nodes.start(MONITOR, autostart="false", profile="step", serial_number="SN-12",
                output_directory=str(tmp_path / "records"), record_verdict="false")

    def call(kind, name, request):
        client = watcher.node.create_client(kind, f"/ema_monitor/{name}")
        watcher.wait(client.service_is_ready, 60.0, name)
        future = client.call_async(request)
        watcher.wait(future.done, 30.0, name)
        return future.result()

    def state():
        return call(GetState, "get_state", GetState.Request()).current_state.label

    def change(number):
        return call(ChangeState, "change_state", ChangeState.Request(
            transition=Transition(id=number))).success

    assert state() == "unconfigured"
    assert change(Transition.TRANSITION_CONFIGURE)
    assert state() == "inactive"
    for number in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_DEACTIVATE, 99):
        assert not change(number), "the state does not allow it"
    assert state() == "inactive"
    assert watcher.node.missing() == "the monitor"
    assert change(Transition.TRANSITION_ACTIVATE)
    watcher.wait_for_simulator()
    answer = watcher.self_test()
    assert answer["passed"]
    assert answer["serial_number"] == "SN-12"
    leave_the_record_alone(watcher, answer["by_name"]["record"]["values"]["path"])
    assert change(Transition.TRANSITION_DEACTIVATE)
    watcher.wait(lambda: watcher.node.missing() == "the monitor", what="the end of the service")
    assert change(Transition.TRANSITION_CLEANUP)
    assert change(Transition.TRANSITION_CONFIGURE)
    assert change(Transition.TRANSITION_ACTIVATE)
    watcher.wait_for_monitor()
    assert watcher.self_test()["passed"]


def test_a_node_that_is_shut_down_from_outside_acts_no_more(nodes, watcher, tmp_path):
    nodes.start(SIMULATOR)
    nodes.start(MONITOR, profile="step", output_directory=str(tmp_path / "records"))
    watcher.wait_for_simulator()
    watcher.wait_for_monitor()
    for name in ("ema_monitor", "ema_sim"):
        client = watcher.node.create_client(ChangeState, f"/{name}/change_state")
        watcher.wait(client.service_is_ready, what=name)
        future = client.call_async(ChangeState.Request(
            transition=Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN)))
        watcher.wait(future.done, what=name)
        assert future.result().success
    watcher.wait(lambda: watcher.node.missing() == "the monitor", what="the end of the service")
    watcher.wait(lambda: watcher.node.count_subscribers(COMMAND) == 0
                 and watcher.node.count_publishers(SAMPLES) == 0, what="the end of the actuator")
