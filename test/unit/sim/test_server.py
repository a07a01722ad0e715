"""The simulator without the middleware: what is published, when, for which command."""

import dataclasses
import itertools

import numpy as np
import pytest

from ema_record.actuator import load_actuator
from ema_record.errors import UsageError
from ema_record.profile import load_profile, step_profile
from ema_record.wire.samples import decode_block
from ema_record.wire.topics import (
    DC_BUS,
    JOINT_STATES,
    PHASE_CURRENTS,
    SAMPLES,
    TOPICS,
    WINDING_TEMPERATURE,
)
from ema_record.wire.types import deserialize, stamp_of
from ema_sim.model_file import load_model_file
from ema_sim.node.server import INVERTER_OFF, ActuatorServer, profile_of_command
from ema_sim.node.settings import parameter_specs, settings_from
from ema_sim.session import ActuatorSession
from ema_sim.simulate import simulate

EPOCH = 1_700_000_000_000_000_000
STEP = load_profile("step")


class Clock:
    """A clock that the test turns."""

    def __init__(self):
        self.now = 50.0

    def __call__(self):
        return self.now

    def wall(self):
        return EPOCH + round((self.now - 50.0) * 1e9)


def settings(**changes):
    model = load_model_file()
    values = {spec.name: spec.default for spec in parameter_specs(model)}
    return settings_from({**values, **changes}, model)


def make(**changes):
    clock = Clock()
    return ActuatorServer(settings(**changes), clock, clock.wall), clock


def run(server, clock, step=0.005):
    """Turn the clock until the server is idle; return messages with their times."""
    found = []
    while server.active:
        clock.now += step
        found += [(clock.now, message) for message in server.poll()]
    return found


def samples_of(messages):
    return np.concatenate([decode_block(m.data) for _, m in messages if m.topic == SAMPLES])


def test_a_command_gives_what_simulate_gives():
    server, clock = make(seed=4)
    server.command(STEP.points, 77)
    samples = samples_of(run(server, clock))
    assert np.array_equal(samples, simulate(STEP, seed=4).samples)
    status = server.status()
    assert status["samples_published"] == str(len(samples))
    assert status["command_stamp"] == "77"
    assert status["start_time"] == str(EPOCH)
    assert status["state"] == "idle"


@pytest.mark.parametrize("factor", [0.5, 1.0, 4.0])
def test_pacing_by_deadlines(factor):
    server, clock = make(real_time_factor=factor)
    server.command(STEP.points, 1)
    for now, message in run(server, clock, 0.003):
        if message.topic == SAMPLES:
            end = decode_block(message.data)[-1, 0] + 2.5e-5
            late = (now - 50.0) - end / factor
            assert -1e-9 <= late < 0.021 / factor + 0.004


def test_without_pacing_the_clock_does_not_matter():
    server, clock = make(real_time_factor=0.0)
    server.command(STEP.points, 1)
    messages = list(itertools.chain.from_iterable(
        [(clock.now, m) for m in server.poll()] for _ in range(3)
    ))
    assert len(samples_of(messages)) == 9000


def test_views_bus_and_temperature_and_their_rates():
    server, clock = make()
    server.command(load_profile("extended").points, 1)
    messages = [m for _, m in run(server, clock)]
    count = {topic: sum(m.topic == topic for m in messages) for topic in TOPICS}
    assert count[JOINT_STATES] == count[PHASE_CURRENTS] == 6260
    assert count[DC_BUS] == 157
    assert 29 <= count[WINDING_TEMPERATURE] <= 33
    stamps = [
        stamp_of(deserialize(m.data, TOPICS[m.topic].type, m.topic)) - EPOCH
        for m in messages if m.topic == JOINT_STATES
    ]
    assert np.allclose(np.diff(stamps), 5e5)
    last = deserialize(messages[-1].data, TOPICS[messages[-1].topic].type, "")
    assert stamp_of(last) - EPOCH <= 3.13e9


def test_ten_readings_a_second_while_idle():
    server, clock = make()
    found = []
    for _ in range(1000):
        clock.now += 0.002
        found += list(server.poll())
    joints = [m for m in found if m.topic == JOINT_STATES]
    assert 19 <= len(joints) <= 21
    joint = deserialize(joints[0].data, TOPICS[JOINT_STATES].type, JOINT_STATES)
    assert joint.position[1] == pytest.approx(-0.4)
    assert not any(m.topic == SAMPLES for m in found)


def test_a_command_out_of_bounds_leaves_the_active_one_alone():
    server, clock = make()
    server.command(STEP.points, 1)
    clock.now += 0.1
    before = list(server.poll())
    with pytest.raises(UsageError, match="/ema/command"):
        server.command([(0.0, 11.0)], 2)
    rest = run(server, clock)
    assert server.status()["command_stamp"] == "1"
    assert len(samples_of([(0.0, m) for m in before] + rest)) == 9000


def test_a_new_command_goes_on_in_time_and_position():
    server, clock = make()
    server.command(STEP.points, 1)
    clock.now += 0.2
    first = samples_of([(0.0, m) for m in server.poll()])
    server.command([(0.0, -0.4)], 2)
    second = samples_of(run(server, clock))
    assert second[0, 0] == pytest.approx(first[-1, 0] + 5e-5)
    assert server.session.surface_position == pytest.approx(-0.4, abs=2e-3)
    assert server.samples_published == len(first) + len(second)


def test_another_actuator_takes_the_place_where_the_surface_stands():
    server, clock = make()
    server.command([(0.0, 0.2)], 1)
    run(server, clock)
    server.reconfigure(settings(**{"turn_short.fraction": 0.2}))
    assert server.session.surface_position == pytest.approx(0.2, abs=2e-3)
    assert server.session.effects.turn_short.fraction == 0.2


def test_the_actuator_knows_its_position_from_the_transducer_alone():
    server, clock = make(**{"position_sensor_offset.offset": 0.05})
    assert float(server.status()["surface_position"]) == pytest.approx(-0.35)
    server.command([(0.0, -0.4)], 1)
    run(server, clock)
    assert float(server.status()["surface_position"]) == pytest.approx(-0.4, abs=2e-3)
    assert server.session.surface_position == pytest.approx(-0.45, abs=2e-3)


def test_one_point_is_a_step_after_the_inverter_is_on():
    profile = profile_of_command([(0.0, 0.4)], -0.4, load_actuator())
    assert profile.points[1:3] == ((INVERTER_OFF, -0.4), (INVERTER_OFF, 0.4))
    assert profile.duration > INVERTER_OFF + 0.8 / 1.5812
    assert profile_of_command([(2.0, 0.4)], -0.4, load_actuator()).duration == 2.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_surface_that_reads_beyond_its_end_stop_obeys_a_step_back(side):
    """Also that by which the monitor stops it where it is; its transducer is off."""
    for target in (0.6, 0.5):
        server, clock = make(**{
            "initial_position": side * 0.58, "position_sensor_offset.offset": side * 0.03})
        assert abs(server.measured_position) > 0.6
        server.command([(0.0, side * target)], 1)
        run(server, clock)
        assert server.measured_position == pytest.approx(side * target, abs=5e-3)


def test_several_points_are_the_profile():
    assert profile_of_command(STEP.points, 0.0, load_actuator()) == STEP


def test_defaults_of_effects_are_those_of_the_model_file(tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text("effects: {turn_short: {fraction: 0.05, phase: c}}\n")
    model = load_model_file(path)
    specs = {spec.name: spec for spec in parameter_specs(model)}
    assert specs["turn_short.fraction"].default == 0.05
    assert specs["turn_short.phase"].default == "c"
    values = {name: spec.default for name, spec in specs.items()}
    assert settings_from(values, model).effects == model.effects


def short_travel():
    nominal = load_actuator()
    return nominal._replace(surface=nominal.surface._replace(end_stop=0.3))


def test_the_own_end_stops_bound_a_command():
    """An actuator of +-0.3 rad is not driven to the 0.4 rad of the shipped step."""
    session = ActuatorSession(short_travel(), position=-0.1)
    with pytest.raises(UsageError, match=r"commands -0\.4 rad: outside the end stops .*0\.3 rad"):
        session.command(STEP)
    assert not session.active
    with pytest.raises(UsageError, match="end stops"):
        simulate(step_profile(0.5, start=-0.1), actuator=short_travel())


def test_a_command_beyond_the_end_stops_changes_nothing():
    clock = Clock()
    short = dataclasses.replace(settings(initial_position=0.0), actuator=short_travel())
    server = ActuatorServer(short, clock, clock.wall)
    before = server.runs, server.start_time, server.command_stamp, server.samples_published
    with pytest.raises(UsageError, match="end stops"):
        server.command([(0.0, 0.35)], 7)
    assert not server.active
    assert before == (
        server.runs, server.start_time, server.command_stamp, server.samples_published)
    server.command([(0.0, 0.25)], 8)
    assert server.active


def advance(server, clock, seconds):
    """Turn the clock for a while; return messages with their times."""
    end, found = clock.now + seconds, []
    while clock.now < end:
        clock.now += 0.005
        found += [(clock.now, message) for message in server.poll()]
    return found


@pytest.mark.parametrize("at", [0.03, 0.1, 0.2])
def test_a_stop_holds_the_surface_where_it_is_and_ends_the_run(at):
    server, clock = make(seed=4)
    server.command(STEP.points, 77)
    advance(server, clock, at)
    before = server.measured_position
    server.stop("no weight on wheels")
    samples = samples_of(run(server, clock))
    assert server.stopped == "no weight on wheels"
    overshoot = np.abs(samples[:, 9] - before).max()
    assert overshoot < 0.05, f"{overshoot:.3f} rad at up to 1.58 rad/s"
    assert server.measured_position == pytest.approx(before, abs=5e-3)
    assert np.abs(samples[-100:, 1]).mean() < 0.05 * 790.0, "it is not at rest"
    server.command(STEP.points, 78)
    assert server.stopped == ""


@pytest.mark.parametrize("share", [1.0, 1.2])
def test_a_ramp_is_as_fast_as_the_actuator_at_most(share):
    actuator = load_actuator()
    seconds = 0.4 / (share * actuator.slew_speed)
    points = [(0.0, -0.4), (0.02, -0.4), (0.02 + seconds, 0.0)]
    if share <= 1.0:
        assert profile_of_command(points, -0.4, actuator).points[-1][1] == 0.0
    else:
        back = [(time, -position) for time, position in points]
        for way in (points, back):
            with pytest.raises(
                    UsageError, match=r"1\.9 rad/s from 0\.02 s on, at most 1\.66 rad/s"):
                profile_of_command(way, way[0][1], actuator)


@pytest.mark.parametrize(("column", "value", "word"), [
    (1, 1.6 * 790.6, "slew speed"), (1, -1.6 * 790.6, "slew speed"),
    (9, 0.64, "end stops"), (9, -0.64, "end stops"),
])
def test_a_surface_too_fast_or_too_far_out_is_stopped(monkeypatch, column, value, word):
    server, clock = make(seed=4)
    server.command(STEP.points, 77)
    advance(server, clock, 0.05)
    honest = server.session.advance

    def wrong(n):
        block = honest(n)
        block[-1, column] = value
        return block

    monkeypatch.setattr(server.session, "advance", wrong)
    advance(server, clock, 0.03)
    assert word in server.stopped
    server.stop("no weight on wheels")
    advance(server, clock, 0.03)
    assert server.stopped == "no weight on wheels", "the stop would begin anew with each block"


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_surface_that_reads_beyond_its_end_stop_is_stopped_at_the_stop(side):
    """To be held beyond it would be refused, and the surface go on."""
    server, clock = make(**{
        "initial_position": side * 0.58, "position_sensor_offset.offset": side * 0.05})
    server.command([(0.0, side * 0.6), (0.5, side * 0.5)], 1)
    server.stop("no weight on wheels")
    run(server, clock)
    assert server.measured_position == pytest.approx(side * 0.6, abs=5e-3)
