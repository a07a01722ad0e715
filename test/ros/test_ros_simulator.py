"""The simulator node: topics, commands, parameters, counters."""

import numpy as np
import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from ros_processes import MONITOR, PROGNOSTICS, SIMULATOR
from std_msgs.msg import Header

from ema_monitor.moves import step_to
from ema_record.profile import load_profile
from ema_record.wire.topics import DEADMAN, SAMPLES, TOPICS
from ema_ros.messages import make_publisher, qos_profile
from ema_sim.effects import EFFECTS


def call(watcher, kind, name, request):
    client = watcher.node.create_client(kind, name)
    watcher.wait(client.service_is_ready, what=name)
    future = client.call_async(request)
    watcher.wait(future.done, what=name)
    return future.result()


def test_every_topic_of_the_table_with_its_type_and_qos(nodes, watcher, tmp_path):
    nodes.start(SIMULATOR)
    nodes.start(PROGNOSTICS)
    nodes.start(MONITOR, output_directory=str(tmp_path))
    watcher.wait_for_simulator()
    watcher.wait(lambda: not watcher.node.missing(), 60.0, "all nodes")
    for topic in TOPICS.values():  # each endpoint is discovered by itself
        watcher.wait(lambda t=topic: watcher.node.count_publishers(t.name), what=topic.name)
        infos = watcher.node.get_publishers_info_by_topic(topic.name)
        for info in infos:
            assert info.topic_type == topic.type, topic.name
            qos = info.qos_profile
            assert qos.reliability == ReliabilityPolicy.get_from_short_key(topic.qos.reliability)
            assert qos.durability == DurabilityPolicy.get_from_short_key(topic.qos.durability)
    # The history is not sent over the wire: what the nodes build their publishers from.
    assert qos_profile(TOPICS[SAMPLES].qos).history == HistoryPolicy.KEEP_ALL
    services = dict(watcher.node.get_service_names_and_types())
    assert services["/ema_monitor/self_test"] == ["diagnostic_msgs/srv/SelfTest"]


def test_a_command_gives_all_samples_of_its_profile_in_real_time(nodes, watcher):
    nodes.start(SIMULATOR)
    watcher.wait_for_simulator()
    profile = load_profile("step")
    stamp = watcher.command(profile)
    watcher.wait(lambda: watcher.actuator["command_stamp"] == stamp
                 and watcher.actuator["state"] == "idle", what="end of the run")
    watcher.wait(lambda: sum(map(len, watcher.blocks)) >= 9000, what="samples")
    samples = np.concatenate(watcher.blocks)
    assert watcher.actuator["samples_published"] == "9000" == str(len(samples))
    assert np.allclose(samples[:, 0], (np.arange(9000) + 0.5) / 20_000.0)
    assert {len(block) for block in watcher.blocks} == {400, 200}
    assert float(watcher.actuator["surface_position"]) == pytest.approx(0.4, abs=2e-3)


@pytest.mark.slow
def test_a_new_command_pre_empts_the_active_one(nodes, watcher):
    nodes.start(SIMULATOR)
    watcher.wait_for_simulator()
    watcher.command(load_profile("extended"))
    watcher.wait(lambda: sum(map(len, watcher.blocks)) >= 4000, what="samples")
    stamp = watcher.command(step_to(-0.3))
    watcher.wait(lambda: watcher.actuator["command_stamp"] == stamp
                 and watcher.actuator["state"] == "idle", what="end of the second command")
    samples = np.concatenate(watcher.blocks)
    assert samples[-1, 0] < 3.0, "the first command went on to its end"
    assert np.all(np.diff(samples[:, 0]) > 0.0), "time does not run on across the pre-emption"
    assert float(watcher.actuator["surface_position"]) == pytest.approx(-0.3, abs=2e-3)


@pytest.mark.slow
def test_it_obeys_on_the_wheels_alone(nodes, watcher):
    nodes.start(SIMULATOR)
    watcher.node.weight_on_wheels = False
    watcher.wait_for_simulator()
    watcher.command(load_profile("step"))
    watcher.wait(lambda: "refused: no weight on wheels" in watcher.actuator["message"],
                 what="refusal")
    assert watcher.blocks == []
    watcher.node.weight_on_wheels = True
    watcher.node.send_weight_on_wheels()
    watcher.spin_for(0.3)  # two topics: the command may overtake it
    stamp = watcher.command(load_profile("extended"))
    watcher.wait(lambda: sum(map(len, watcher.blocks)) >= 2000, what="samples")
    watcher.node.send = False
    watcher.wait(lambda: "stopped: weight-on-wheels signal is 1." in watcher.actuator["message"],
                 what="the stop of a silent aircraft")
    watcher.wait(lambda: watcher.actuator["state"] == "idle", what="surface at rest")
    assert watcher.actuator["command_stamp"] == stamp


@pytest.mark.slow
def test_who_would_think_that_he_is_watched_is_refused(nodes, watcher):
    """Signs of life at best effort are not heard; beside others that are, they do not matter."""
    nodes.start(SIMULATOR)
    watcher.wait_for_simulator()
    watcher.node.create_publisher(Header, DEADMAN, QoSProfile(
        depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
    watcher.spin_for(0.5)
    watcher.command(load_profile("step"))
    watcher.wait(lambda: "refused" in watcher.actuator["message"], what="refusal")
    assert f"({DEADMAN} is published, but not reliably)" in watcher.actuator["message"]
    assert watcher.blocks == []
    heard = make_publisher(watcher.node, DEADMAN)
    watcher.wait(lambda: heard.get_subscription_count() > 0, what="the match")
    watcher.spin_for(0.2)
    watcher.command(load_profile("step"))
    watcher.wait(lambda: watcher.blocks, what="samples")


@pytest.mark.slow
def test_a_command_out_of_bounds_is_refused_and_said(nodes, watcher):
    nodes.start(SIMULATOR)
    watcher.wait_for_simulator()
    wrong = step_to(0.3).model_copy(update={"points": ((0.001, 5.0),)})
    watcher.command(wrong)
    watcher.wait(lambda: "refused" in watcher.actuator["message"], what="refusal")
    assert watcher.actuator["state"] == "idle"
    assert "5" in watcher.actuator["message"]


@pytest.mark.slow
def test_parameters_are_described_bounded_and_settable_when_idle(nodes, watcher):
    nodes.start(SIMULATOR, turn_short__phase="b")
    watcher.wait_for_simulator()
    names = [f"{effect}.{field.name}" for effect, entry in EFFECTS.items()
             for field in entry.fields]
    fixed = ["model_file", "serial_number", "seed", "switching", "rate", "block_size",
             "initial_position", "slow_reader_timeout", "weight_on_wheels_timeout",
             "deadman_timeout"]
    names += [*fixed, "noise", "real_time_factor"]
    descriptors = call(watcher, DescribeParameters, "/ema_sim/describe_parameters",
                       DescribeParameters.Request(names=names)).descriptors
    assert [d.name for d in descriptors] == names
    assert all(d.description for d in descriptors)
    assert {d.name for d in descriptors if d.read_only} == set(fixed)
    for d in descriptors:
        if d.type == ParameterType.PARAMETER_DOUBLE:
            assert d.floating_point_range[0].to_value > d.floating_point_range[0].from_value

    def set_one(name, value):
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        return call(watcher, SetParameters, "/ema_sim/set_parameters", request).results[0]

    assert set_one("turn_short.fraction", 0.2).successful
    assert not set_one("turn_short.fraction", 0.95).successful
    assert not set_one("turn_short.phase", "d").successful
    assert not set_one("seed", 3).successful, "read-only"
    assert not set_one("use_sim_time", True).successful
    watcher.command(load_profile("extended"))
    watcher.wait(lambda: watcher.actuator["state"] == "active", what="run")
    refused = set_one("turn_short.fraction", 0.1)
    assert not refused.successful
    assert "idle" in refused.reason


def test_a_node_that_ends_at_its_start_is_told_at_once(nodes, watcher):
    nodes.start(SIMULATOR, seed="none")
    with pytest.raises(AssertionError, match=r"ended with status 2: .*seed"):
        watcher.wait_for_simulator()


@pytest.mark.parametrize(("name", "value", "hint"), [
    ("turn_short__fractoin", 0.1, "did you mean 'turn_short.fraction'"),
    ("noise", "[]", "a parameter has no value"),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ("turn_short__fraction", 2.0, "0 to 0.9"),
        ("rotor_eccentricity__mode", "papr", "did you mean 'paper'"),
        ("noise", "much", "expected float"),
        ("use_sim_time", "true", "use_sim_time: true is not supported"),
        ("model_file", "/nonexistent/model.yaml", "/nonexistent/model.yaml"))),
])
def test_a_wrong_parameter_is_one_line_and_status_2(nodes, name, value, hint):
    process = nodes.start(SIMULATOR, **{name: value})
    assert process.wait(60.0) == 2
    (line,) = [x for x in nodes.log(process).splitlines() if x.startswith("error: ")]
    assert hint in line
