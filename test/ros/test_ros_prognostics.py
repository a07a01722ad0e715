"""The prognostics node: records announced before and after its start, and by parameter."""

import json
import shutil

import pytest
import rclpy.serialization
from diagnostic_msgs.msg import DiagnosticStatus
from ros_processes import PROGNOSTICS
from std_msgs.msg import Float64, String

from ema_phm.api import to_json
from ema_prognostics.prognostics_node import LONGEST_PATH, NOT_A_BAG
from ema_record.bag.read import write_bag
from ema_record.profile import load_profile
from ema_record.wire.topics import BIT_RECORD, SEVERITY, VERDICT
from ema_ros.messages import (
    PolledGroup,
    make_polled_subscription,
    make_publisher,
    take_all,
    values_of,
)
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Return a healthy bag and one with a fault."""
    folder = tmp_path_factory.mktemp("bags")
    profile = load_profile("step")
    return [
        write_bag(simulate(profile, seed=5, serial_number="EMA-5"), folder / "first"),
        write_bag(simulate(profile, seed=6, effects=parse_effects(
            ["turn_short.fraction=0.1", "turn_short.phase=b"])), folder / "second"),
    ]


class Listener:
    """All verdicts and severities since the start of the test."""

    def __init__(self, watcher):
        group = PolledGroup()
        self._watcher = watcher
        self._verdict = make_polled_subscription(watcher.node, VERDICT, group)
        self._severity = make_polled_subscription(watcher.node, SEVERITY, group)
        self.verdicts, self.severities = [], []

    def collect(self):
        for taken in take_all(self._verdict):
            status = rclpy.serialization.deserialize_message(taken.data, DiagnosticStatus)
            self.verdicts.append(values_of(status))
        for taken in take_all(self._severity):
            self.severities.append(
                rclpy.serialization.deserialize_message(taken.data, Float64).data)
        return len(self.verdicts)

    def wait(self, count):
        self._watcher.wait(lambda: self.collect() >= count, 60.0, f"{count} verdicts")

    def stay(self, seconds):
        self._watcher.spin_for(seconds, self.collect)


@pytest.fixture
def listener(watcher):
    """Return a listener to verdicts."""
    return Listener(watcher)


@pytest.mark.slow
def test_records_before_and_after_the_start_are_diagnosed_once(nodes, watcher, listener, bags):
    announce = make_publisher(watcher.node, BIT_RECORD)
    announce.publish(String(data=str(bags[0])))
    nodes.start(PROGNOSTICS)
    listener.wait(1)
    announce.publish(String(data=str(bags[1])))
    listener.wait(2)
    announce.publish(String(data=str(bags[0])))
    listener.stay(1.0)
    # As of `ema check --json`, but for the hash of the bag, which is to hold the verdict.
    expected = json.loads(json.dumps([to_json(bag) | {"record_sha256": None} for bag in bags]))
    assert [json.loads(v["json"]) for v in listener.verdicts] == expected
    assert listener.verdicts[1]["verdict"] == "fault"
    assert listener.verdicts[1]["fault_class"] == "turn_short"
    assert listener.verdicts[1]["phase"] == "b"
    assert float(listener.verdicts[1]["severity"]) == pytest.approx(
        listener.severities[1], rel=1e-4)
    assert any(key.startswith("probability.") for key in listener.verdicts[1])


def test_a_record_by_parameter(nodes, listener, bags):
    nodes.start(PROGNOSTICS, record=bags[1])
    listener.wait(1)
    assert listener.verdicts[0]["fault_class"] == "turn_short"


@pytest.mark.slow
def test_a_bad_record_has_a_verdict_too_that_does_not_tell_which_files_exist(
    nodes, watcher, listener, bags, tmp_path
):
    text, empty, damaged = tmp_path / "text.csv", tmp_path / "empty", tmp_path / "damaged"
    text.write_text("a,b\n1,2\n")
    empty.mkdir()
    damaged.mkdir()
    (damaged / "metadata.yaml").write_text("secret: 1")
    (mcap,) = bags[0].glob("*.mcap")  # readable by itself, but no bag
    wrong = [tmp_path / "nowhere", text, empty, damaged, mcap, "/dev/zero", "relative",
             "/" + 300 * "a", "/\x7f"]
    announce = make_publisher(watcher.node, BIT_RECORD)
    process = nodes.start(PROGNOSTICS)
    for count, path in enumerate(wrong, 1):
        announce.publish(String(data=str(path)))
        listener.wait(count)
    assert [v["verdict"] for v in listener.verdicts] == ["invalid"] * len(wrong)
    assert {v["reasons"] for v in listener.verdicts} == {NOT_A_BAG}
    assert "relative_file_paths" in nodes.log(process), "the operator is not told why"
    announce.publish(String(data=str(bags[1])))
    listener.wait(len(wrong) + 1)
    assert listener.verdicts[-1]["verdict"] == "fault"


@pytest.mark.slow
def test_what_was_whole_is_judged_once_and_what_was_not_each_time(
    nodes, watcher, listener, bags, tmp_path
):
    """A record that is announced before it is whole is judged when it is announced again."""
    announce = make_publisher(watcher.node, BIT_RECORD)
    nodes.start(PROGNOSTICS)
    announce.publish(String(data="/" + "x" * LONGEST_PATH))  # too long: no answer
    late = tmp_path / "late"
    announced = [late, late, bags[0], bags[0], late]
    for path, count in zip(announced, (1, 2, 3, 3, 4)):
        if path == late and count == 4:
            shutil.copytree(bags[1], late)
        announce.publish(String(data=str(path)))
        listener.wait(count)
    found = [json.loads(v["json"]) for v in listener.verdicts]
    assert [v["bag"] for v in found] == [str(p) for p in (late, late, bags[0], late)]
    assert [v["verdict"] for v in found] == ["invalid", "invalid", found[2]["verdict"], "fault"]
    assert found[2]["verdict"] != "invalid"


def test_a_wrong_model_is_one_line_and_status_2(nodes):
    process = nodes.start(PROGNOSTICS, model_file="/nonexistent/model.json")
    assert process.wait(60.0) == 2
    assert "error: /nonexistent/model.json" in nodes.log(process)


@pytest.mark.slow
def test_a_baseline_by_parameter(nodes, listener, bags):
    nodes.start(PROGNOSTICS, record=bags[1], baseline=bags[0])
    listener.wait(1)
    assert listener.verdicts[0]["verdict"] == "invalid"  # of another actuator
    assert "EMA-5" in listener.verdicts[0]["reasons"]
    process = nodes.start(PROGNOSTICS, baseline="/nonexistent/bag")
    assert process.wait(60.0) == 2
    assert "cannot serve as baseline" in nodes.log(process)
