"""The monitor node: interlock, abort, counters, and what is in its way."""

import signal
import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from diagnostic_msgs.srv import SelfTest
from lifecycle_msgs.srv import GetState
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from ros_processes import MONITOR, SIMULATOR
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from ema_monitor.aircraft_node import verdict_of
from ema_monitor.messages import find_actuator
from ema_monitor.moves import step_to
from ema_monitor.observation import ActuatorStatus
from ema_record.bag.read import read_bag
from ema_record.wire.topics import (
    BIT_RECORD,
    COMMAND,
    DEADMAN,
    DIAGNOSTICS,
    SAMPLES,
    SELF_TEST_SERVICE,
    VERDICT,
    WEIGHT_ON_WHEELS,
)
from ema_ros.messages import PolledGroup, make_polled_subscription, make_publisher, unheard


@pytest.fixture
def chain(nodes, watcher, tmp_path):
    """Start simulator and monitor; return a function that does."""

    def start(profile="step", position=-0.4, **parameters):
        simulator = nodes.start(SIMULATOR, initial_position=position)
        monitor = nodes.start(
            MONITOR, profile=profile, output_directory=str(tmp_path / "records"), **parameters
        )
        watcher.wait_for_simulator()
        watcher.wait_for_monitor()
        return simulator, monitor

    return start


def records(tmp_path):
    return sorted((tmp_path / "records").glob("*"))


def test_a_test_moves_to_its_start_and_loses_no_sample(chain, watcher, tmp_path):
    chain(position=0.1)
    answer = watcher.self_test()
    assert answer["passed"], answer
    assert answer["serial_number"] == "SIM-0000"
    counters = answer["by_name"]["counters"]["values"]
    assert counters == {"samples_published": "9000", "samples_recorded": "9000"}
    for name in ("count", "time order", "finite", "range", "saturation", "current sum",
                 "speed against position", "command reached"):
        assert answer["by_name"][name]["level"] == 0, name
    (path,) = records(tmp_path)
    assert answer["by_name"]["record"]["values"]["path"] == str(path)
    record = read_bag(path)
    assert len(record) == 9000
    assert record.profile.name == "step"
    assert record.provenance.status == "complete"
    assert record.samples[0, 9] == pytest.approx(-0.4, abs=2e-3)


def test_refused_without_weight_on_wheels(chain, nodes, watcher, tmp_path):
    _, monitor = chain()
    watcher.node.weight_on_wheels = False
    watcher.node.send_weight_on_wheels()
    watcher.spin_for(0.5)
    answer = watcher.self_test()
    assert not answer["passed"]
    assert answer["by_name"]["test"]["message"] == (
        "refused: no weight on wheels: the aircraft is not on the ground"
    )
    assert "test refused: no weight on wheels" in nodes.log(monitor), "who reads the log alone"
    assert records(tmp_path) == []
    assert watcher.blocks == [], "the actuator moved"


@pytest.mark.slow
def test_a_request_that_overtakes_weight_on_wheels_waits_for_it(chain, watcher):
    watcher.node.send = False
    chain()
    begin = time.monotonic()

    def arrive():
        watcher.node.send = time.monotonic() - begin > 0.4

    answer = watcher.self_test(during=arrive)
    assert answer["passed"], answer


@pytest.mark.slow
def test_refused_when_no_weight_on_wheels_ever_comes(chain, watcher, tmp_path):
    watcher.node.send = False
    chain(weight_on_wheels_timeout=0.5)
    begin = time.monotonic()
    answer = watcher.self_test()
    assert answer["by_name"]["test"]["message"] == (
        "refused: no weight-on-wheels signal from the aircraft"
    )
    assert time.monotonic() - begin > 0.5, "the first message was not waited for"
    assert records(tmp_path) == []


@pytest.mark.slow
def test_refused_when_weight_on_wheels_is_stale(chain, watcher, tmp_path):
    chain()
    time.sleep(1.3)  # the aircraft says nothing: this is what is tested
    future = watcher.node.call_self_test()
    for timer in watcher.node.timers:
        timer.cancel()
    watcher.wait(future.done)
    assert future.result().passed == b"\x00"
    assert "old, at most 1 s" in future.result().status[0].message
    assert records(tmp_path) == []


@pytest.mark.slow
def test_aborts_when_the_aircraft_takes_off_and_stops_the_surface(chain, watcher, tmp_path):
    """It stays where it stopped; the next test moves it to its start."""
    chain("extended")

    def take_off():
        if sum(map(len, watcher.blocks)) > 10_000:
            watcher.node.weight_on_wheels = False

    answer = watcher.self_test(during=take_off)
    assert not answer["passed"]
    assert answer["by_name"]["test"]["message"] == (
        "aborted: no weight on wheels: the aircraft is not on the ground"
    )
    (path,) = records(tmp_path)
    assert (path / "metadata.yaml").is_file()
    record = read_bag(path)
    assert record.provenance.status == "aborted"
    assert 10_000 < len(record) < 25_000
    watcher.wait(lambda: watcher.actuator["state"] == "idle", what="surface at rest")
    stopped = float(watcher.actuator["surface_position"])
    last = watcher.blocks[-1][-1]
    assert stopped == pytest.approx(last[9], abs=2e-3)
    assert abs(last[1]) < 20.0, "the motor still turns with the last sample"
    assert sum(map(len, watcher.blocks)) < 30_000, "the test went on"
    assert watcher.actuator["message"].startswith("stopped: no weight on wheels")

    watcher.node.weight_on_wheels = True
    watcher.node.send_weight_on_wheels()
    watcher.spin_for(1.4)
    answer = watcher.self_test()
    assert answer["passed"], "the monitor does not run another test after an abort"
    assert len(records(tmp_path)) == 2


def test_abort_stops_the_surface_and_ends_the_test(chain, watcher, tmp_path):
    chain("extended")
    client = watcher.node.create_client(Trigger, "/ema_monitor/abort")
    calls = []

    def ask():
        if not calls and sum(map(len, watcher.blocks)) > 4000:
            calls.append(client.call_async(Trigger.Request()))

    answer = watcher.self_test(during=ask)
    assert answer["by_name"]["test"]["message"] == "aborted: the test was asked to end"
    assert calls[0].result().success
    assert read_bag(records(tmp_path)[0]).provenance.status == "aborted"
    watcher.wait(lambda: watcher.actuator["state"] == "idle", what="surface at rest")
    idle = client.call_async(Trigger.Request())
    watcher.wait(idle.done, what="second abort")
    assert (idle.result().success, idle.result().message) == (False, "no test runs")


@pytest.mark.slow
def test_abort_also_ends_a_test_that_waits_for_the_aircraft(chain, watcher, tmp_path):
    watcher.node.send = False
    chain(weight_on_wheels_timeout=5.0)
    client = watcher.node.create_client(Trigger, "/ema_monitor/abort")
    watcher.wait(client.service_is_ready, what="the service")
    begin, calls = time.monotonic(), []

    def ask():
        if not calls and time.monotonic() - begin > 0.5:
            calls.append(client.call_async(Trigger.Request()))
        watcher.node.send = bool(calls) and calls[0].done()

    answer = watcher.self_test(during=ask)
    assert answer["by_name"]["test"]["message"] == "refused: the test was asked to end"
    watcher.wait(calls[0].done, what="the answer")
    assert calls[0].result().success
    assert records(tmp_path) == []


@pytest.mark.slow
def test_a_killed_monitor_stops_the_surface(chain, watcher):
    _, monitor = chain("extended")
    watcher.node.call_self_test()
    watcher.wait(lambda: sum(map(len, watcher.blocks)) > 4000, what="the test")
    begin = time.monotonic()
    monitor.kill()
    watcher.wait(lambda: "no sign of life" in watcher.actuator["message"], 5.0, "the stop")
    assert time.monotonic() - begin < 2.0
    watcher.wait(lambda: watcher.actuator["state"] == "idle", what="surface at rest")
    assert int(watcher.actuator["samples_published"]) < 62_600


def test_a_foreign_command_aborts_the_test(chain, watcher, tmp_path):
    chain("extended")
    sent = []

    def interfere():
        if not sent and sum(map(len, watcher.blocks)) > 4000:
            sent.append(watcher.command(step_to(-0.2)))

    answer = watcher.self_test(during=interfere)
    assert not answer["passed"]
    assert "another node commands" in answer["by_name"]["test"]["message"]
    assert read_bag(records(tmp_path)[0]).provenance.status == "aborted"
    watcher.wait(lambda: watcher.actuator["state"] == "idle")
    assert float(watcher.actuator["surface_position"]) == pytest.approx(-0.2, abs=2e-3)


@pytest.mark.parametrize(("begun", "why"), [
    pytest.param(0, "2 actuators report here: ", marks=pytest.mark.slow),  # waits 10 s for one
    (4000, "the actuator was SIM-0000 and is RIG-1 now")])
def test_who_is_tested_is_known(chain, watcher, begun, why):
    """A standby lane that calls itself the actuator, and a unit that is exchanged."""
    chain("extended")
    publisher = watcher.node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def report():
        if sum(map(len, watcher.blocks)) >= begun:
            publisher.publish(DiagnosticArray(status=[status_of("lane2: actuator")]))

    watcher.spin_for(1.0 - begun / 4000, report)  # before the test, where it stands by
    answer = watcher.self_test(during=report)
    assert not answer["passed"]
    assert why in answer["by_name"]["test"]["message"]


@pytest.mark.slow
def test_damaged_messages_end_no_node_and_in_doubt_the_surface_stops(chain, watcher, tmp_path):
    running = chain("extended")
    damaged = [make_publisher(watcher.node, topic)
               for topic in (DEADMAN, DIAGNOSTICS, VERDICT, COMMAND, WEIGHT_ON_WHEELS)]
    watcher.wait(lambda: all(p.get_subscription_count() > 0 for p in damaged), what="readers")
    for publisher in damaged:
        publisher.publish(b"\x00")
        publisher.publish(b"\x00\x01\x00\x00\xff\xff\xff\x7f")
    watcher.spin_for(1.4)
    sent = []

    def damage():
        if not sent and sum(map(len, watcher.blocks)) > 4000:
            sent.append(damaged[-1].publish(b"\x00\x01\x00\x00"))

    answer = watcher.self_test(during=damage)
    assert "weight on wheels" in answer["by_name"]["test"]["message"]
    assert read_bag(records(tmp_path)[0]).provenance.status == "aborted"
    assert [process.poll() for process in running] == [None, None]


@pytest.mark.slow
def test_a_killed_acquisition_aborts_the_test(chain, watcher, tmp_path):
    # Longer than a busy machine keeps the monitor from its first block.
    simulator, _ = chain("extended", stream_timeout=2.0)

    def kill():
        if simulator.poll() is None and sum(map(len, watcher.blocks)) > 4000:
            simulator.send_signal(signal.SIGKILL)

    answer = watcher.self_test(during=kill)
    assert "the acquisition has stopped" in answer["by_name"]["test"]["message"]
    assert read_bag(records(tmp_path)[0]).provenance.status == "aborted"


@pytest.mark.slow
def test_a_record_bears_the_serial_number_of_the_actuator_that_is_there_now(
    nodes, chain, watcher, tmp_path
):
    simulator, _ = chain()
    assert watcher.self_test()["serial_number"] == "SIM-0000"
    simulator.send_signal(signal.SIGINT)
    assert simulator.wait(10.0) == 0
    watcher.actuator = {}
    nodes.start(SIMULATOR, serial_number="SIM-0001")
    watcher.wait_for_simulator()
    answer = watcher.self_test()
    assert answer["serial_number"] == "SIM-0001"
    record = read_bag(answer["by_name"]["record"]["values"]["path"])
    assert record.provenance.serial_number == "SIM-0001"


@pytest.mark.slow
@pytest.mark.parametrize(("second", "why"), [
    (SIMULATOR, "refused: 2 nodes publish /ema/samples, expected one actuator"),
    (MONITOR, "refused: another monitor offers /ema_monitor/self_test on this domain"),
])
def test_refused_where_two_are_there_that_were_not_when_it_started(
    nodes, watcher, tmp_path, second, why
):
    tested = {"profile": "step", "output_directory": tmp_path / "records"}
    nodes.start(SIMULATOR)
    monitor = nodes.start(MONITOR, **tested)
    watcher.wait_for_simulator()
    watcher.wait_for_monitor()
    monitor.send_signal(signal.SIGSTOP)  # the second one does not see it, or would not start
    other = nodes.start(second, **(tested if second == MONITOR else {}))
    watcher.wait(lambda: "ready" in nodes.log(other), 60.0, "the second one")
    monitor.send_signal(signal.SIGCONT)
    count = watcher.node.count_publishers
    topic = SAMPLES if second == SIMULATOR else BIT_RECORD
    watcher.wait(lambda: count(topic) == 2, 60.0, "both of them")
    watcher.spin_for(1.5)
    answer = watcher.self_test()
    assert answer["by_name"]["test"]["message"] == why
    assert records(tmp_path) == []


@pytest.mark.slow
def test_refused_where_the_actuator_has_gone(chain, watcher, tmp_path):
    simulator, _ = chain()
    watcher.spin_for(1.5)
    simulator.send_signal(signal.SIGINT)
    assert simulator.wait(10.0) == 0
    answer = watcher.self_test()
    assert answer["by_name"]["test"]["message"].startswith("refused: 0 nodes publish /ema/samples")
    assert records(tmp_path) == []


@pytest.mark.slow
def test_ctrl_c_closes_the_record_as_interrupted(chain, watcher, tmp_path):
    _, monitor = chain("extended")
    sent = []

    def interrupt():
        if not sent and sum(map(len, watcher.blocks)) > 4000:
            monitor.send_signal(signal.SIGINT)
            sent.append(True)

    answer = watcher.self_test(during=interrupt)
    assert not answer["passed"]
    assert monitor.wait(5.0) == 0
    record = read_bag(records(tmp_path)[0])
    assert record.provenance.status == "interrupted"
    assert len(record) >= 4000
    watcher.wait(lambda: watcher.actuator["state"] == "idle", what="surface at rest")
    assert float(watcher.actuator["surface_position"]) == pytest.approx(-0.4, abs=2e-3)


@pytest.mark.slow
def test_a_second_request_during_a_test_is_refused(chain, watcher):
    chain()
    second = []

    def ask_again():
        if not second and watcher.blocks:
            second.append(watcher.node.call_self_test())

    first = watcher.self_test(during=ask_again)
    watcher.wait(second[0].done, what="second answer")
    assert first["passed"]
    assert second[0].result().passed == b"\x00"
    assert "running already" in second[0].result().status[0].message


RUNNING = "refused: a test is running already: wait for its end"


def eight_callers(watcher):
    """Ask for the test from eight clients of the service at once; return their futures."""
    clients = [watcher.node.create_client(SelfTest, SELF_TEST_SERVICE) for _ in range(8)]
    watcher.wait(lambda: all(client.service_is_ready() for client in clients), what="service")
    return [client.call_async(SelfTest.Request()) for client in clients]


def messages(watcher, futures):
    """Return what each caller was told, once all are answered."""
    watcher.wait(lambda: all(future.done() for future in futures), 30.0, "eight answers")
    return sorted(future.result().status[0].message for future in futures)


@pytest.mark.slow
def test_eight_callers_at_once_get_one_test_and_seven_refusals(chain, watcher, tmp_path):
    chain()
    assert messages(watcher, eight_callers(watcher)) == ["passed", *[RUNNING] * 7]
    assert len(records(tmp_path)) == 1
    assert watcher.self_test()["passed"], "the monitor runs no second test"


@pytest.mark.slow
def test_an_interlock_that_opens_aborts_the_test_while_calls_wait(chain, watcher, tmp_path):
    """Also where the calls came before the first weight on wheels, and all waited for it."""
    watcher.node.send = False
    chain("extended", weight_on_wheels_timeout=2.0)
    calls = eight_callers(watcher)
    watcher.spin_for(0.3)
    assert not any(call.done() for call in calls)
    watcher.node.send = True
    watcher.wait(lambda: sum(map(len, watcher.blocks)) > 4000, what="the test")
    calls += eight_callers(watcher)
    watcher.node.weight_on_wheels = False
    watcher.node.send_weight_on_wheels()
    off = "no weight on wheels: the aircraft is not on the ground"
    assert messages(watcher, calls[:8]) == [f"aborted: {off}", *[RUNNING] * 7]
    # Those that came with the opening are read before it or after it.
    assert set(messages(watcher, calls[8:])) <= {RUNNING, f"refused: {off}"}
    (path,) = records(tmp_path)
    record = read_bag(path)
    assert record.provenance.status == "aborted"
    assert len(record) < 20_000, "the test went on"

    (refused, *_) = messages(watcher, eight_callers(watcher))
    assert refused == "refused: no weight on wheels: the aircraft is not on the ground"
    watcher.node.weight_on_wheels = True
    watcher.spin_for(2.7)
    assert watcher.self_test()["passed"], "weight on wheels is not evaluated any more"


@pytest.mark.slow
def test_eight_callers_are_answered_when_the_monitor_ends(chain, watcher):
    _, monitor = chain("extended")
    calls = eight_callers(watcher)
    watcher.wait(lambda: sum(map(len, watcher.blocks)) > 4000, what="the test")
    monitor.send_signal(signal.SIGINT)
    assert messages(watcher, calls)[0].startswith("interrupted")
    assert monitor.wait(5.0) == 0


@pytest.mark.slow
def test_a_second_monitor_on_the_domain_is_refused(chain, nodes, watcher):
    chain()
    second = nodes.start(MONITOR)
    assert second.wait(30.0) == 2
    assert "another monitor" in nodes.log(second)
    assert watcher.self_test()["passed"], "the first monitor was disturbed"


@pytest.mark.slow
def test_a_record_that_cannot_be_written_refuses_the_test(nodes, watcher, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("here is no folder")
    nodes.start(SIMULATOR)
    nodes.start(MONITOR, profile="step", output_directory=str(blocked))
    watcher.wait_for_simulator()
    watcher.wait_for_monitor()
    answer = watcher.self_test()
    assert not answer["passed"]
    assert "cannot be written" in answer["by_name"]["test"]["message"]
    assert blocked.read_text() == "here is no folder"


@pytest.mark.parametrize(("parameter", "hint"), [
    ({"profile": "stepp"}, "did you mean 'step'"),
    ({"weight_on_wheels_timeout": 1000.0}, "0.1 to 60"),
    ({"outptu_directory": "x"}, "did you mean 'output_directory'"),
])
def test_wrong_parameters_are_one_line_and_status_2(nodes, parameter, hint):
    process = nodes.start(MONITOR, **parameter)
    assert process.wait(30.0) == 2
    assert hint in nodes.log(process)


def status_of(name, **changes):
    values = {
        "state": "idle", "surface_position": "-0.4", "command_stamp": "5", "start_time": "6",
        "samples_published": "9000", "temperature": "21", **changes,
    }
    return DiagnosticStatus(name=name, hardware_id="RIG-1", values=[
        KeyValue(key=key, value=value) for key, value in values.items() if value])


@pytest.mark.parametrize("name", [
    "ema_sim: actuator", "rig_driver: actuator", "actuator", "/left/ema: actuator",
    "left/actuator",
])
def test_a_driver_of_any_name_is_an_actuator(name):
    """What stands beside it on /diagnostics, of the same name or with fewer keys, is not."""
    namespace = "/left" if "left" in name else ""
    others = [status_of("rig_driver: inverter"), status_of("/right/driver: actuator"),
              status_of("/left/b/driver: actuator"), status_of("driver: actuators"),
              status_of("robot: actuator", command_stamp=""),
              status_of("arm: actuator", surface_position="middle"),
              status_of("leg: actuator", surface_position="nan")]
    assert find_actuator(DiagnosticArray(status=others), namespace) is None
    assert find_actuator(DiagnosticArray(status=[status_of(name)]), "/other") is None
    assert find_actuator(DiagnosticArray(status=[*others, status_of(name)]), namespace) == (
        ActuatorStatus(active=False, surface_position=-0.4, command_stamp=5, start_time=6,
                       samples_published=9000), "RIG-1")
    refused = status_of(name)
    refused.level, refused.message = DiagnosticStatus.WARN, "command refused: beyond a stop"
    found, _ = find_actuator(DiagnosticArray(status=[refused]), namespace)
    assert found.complaint == "command refused: beyond a stop"
    moving = DiagnosticArray(status=[status_of(name, state="homing")])
    assert find_actuator(moving, namespace)[0].active


@pytest.mark.parametrize("said", [{}, {"json": "{"}, {"json": "{}"}, {"json": "[1]"}])
def test_a_verdict_of_somebody_else_is_none(said):
    values = [KeyValue(key=key, value=value) for key, value in said.items()]
    assert verdict_of(DiagnosticStatus(values=values)) is None


def test_a_question_that_was_lost_is_asked_again(watcher):
    """A request is lost where its server has not yet found the client that has found it."""
    context = rclpy.Context()
    rclpy.init(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
    server = rclpy.create_node("ema_sim", context=context, start_parameter_services=False)
    service = server.create_service(GetState, "ema_sim/get_state", lambda _, answer: answer)
    requests = []

    def is_active():
        active = watcher.node.state("ema_sim") == ""
        with service.handle:
            request, header = service.handle.service_take_request(GetState.Request)
        if request is not None:
            requests.append(request)
            if len(requests) > 1:  # the first one is lost
                answer = GetState.Response()
                answer.current_state.label = "active"
                service.send_response(answer, header)
        return active

    try:
        watcher.wait(is_active, what="an answer")
    finally:
        server.destroy_node()
        rclpy.try_shutdown(context=context)
    assert len(requests) == 2


def test_what_is_published_otherwise_than_it_is_needed_is_told(watcher):
    """A driver's samples at best effort; weight on wheels that is not latched is alike."""
    node, group = watcher.node, PolledGroup()
    subscription = make_polled_subscription(node, SAMPLES, group)
    assert unheard(node, subscription) == ""
    wrong = node.create_publisher(Float64MultiArray, SAMPLES, QoSProfile(
        depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
    watcher.wait(lambda: node.count_publishers(SAMPLES) == 1, what="the publisher")
    assert unheard(node, subscription) == f" ({SAMPLES} is published, but not reliably)"
    node.destroy_publisher(wrong)
    make_publisher(node, SAMPLES)
    watcher.wait(lambda: subscription.get_publisher_count() == 1, what="the right publisher")
    assert unheard(node, subscription) == ""
