"""Features of a record: closed forms of the parts, and one record of the simulator."""

import math

import numpy as np
import pytest

from ema_identification.actuator.measure.features import converter_step, feature_map
from ema_identification.actuator.measure.lines import lines, slip_of, turns_of
from ema_identification.actuator.measure.segments import plan
from ema_identification.actuator.measure.signals import (
    TURN,
    between_edges,
    drive_signals,
    roughness,
    section_numbers,
    spreads,
    travels,
)
from ema_record.actuator import load_actuator
from ema_record.channels import PHASE_CURRENTS, REFERENCE_CURRENTS
from ema_record.profile import load_profile, profile_names
from ema_record.profiles.design import default_profiles
from ema_sim.effects import parse_effects
from ema_sim.machine import unit_trapezoid
from ema_sim.simulate import simulate


@pytest.fixture(scope="module")
def nominal():
    return load_actuator()


@pytest.fixture(scope="module")
def runs(nominal):
    """Return records of the default test by the effects hidden in them."""
    profile = load_profile("extended")
    hidden = {
        "": (), "offset": ("current_sensor_offset.phase_b=0.3",),
        "cogging": ("cogging_torque.amplitude=0.02", "cogging_torque.phase=0.5"),
    }
    return {name: simulate(profile, actuator=nominal, effects=parse_effects(e), seed=3)
            for name, e in hidden.items()}


def test_a_line_is_half_its_amplitude_and_drift_leaks_nothing():
    theta = np.linspace(0.3, 0.3 + 5.4 * TURN, 9000)
    signal = np.column_stack([2.0 + 0.1 * np.cos(3.0 * theta - 0.4) + 0.05 * theta])
    turns = turns_of(theta, slice(0, len(theta)))
    found = lines(turns, signal[turns.part], 6)[:, 0]
    assert found[3] == pytest.approx(0.05 * np.exp(-0.4j), abs=1e-4)
    assert np.abs(found[[1, 2, 4, 5, 6]]).max() < 5e-4


def test_signals_are_those_of_plain_formulas(runs, nominal):
    """One pass over the samples gives what numpy gives step by step."""
    record = runs["offset"]
    found = drive_signals(record, nominal)
    currents = record.samples[:, PHASE_CURRENTS] - found.offset
    theta = np.unwrap(record.channel("rotor_angle"))
    shape = np.column_stack([unit_trapezoid(theta - k * TURN / 3.0, nominal.motor.flat_top)
                             for k in range(3)])
    assert found.theta == pytest.approx(theta, abs=1e-9)
    assert found.total == pytest.approx(currents.sum(axis=1), abs=1e-9)
    assert found.torque_current == pytest.approx(
        (0.5 * shape * currents / found.gain).sum(axis=1), abs=2e-3)  # the table's steps
    assert (found.error == record.samples[:, PHASE_CURRENTS]
            - record.samples[:, REFERENCE_CURRENTS]).all()
    travel = found.theta / nominal.gear.ratio - found.position
    assert np.ptp(found.lag - travel) < 1e-12
    assert found.lag[found.time < record.profile.inverter_off].mean() == pytest.approx(
        0.0, abs=1e-12)
    _, vectors = np.linalg.eigh(currents[400:].T @ currents[400:])
    assert found.gain == pytest.approx(
        np.abs(1.0 / vectors[:, 0]) / np.abs(1.0 / vectors[:, 0]).mean(), abs=1e-4)
    part = slice(20_000, 22_000)
    slip = np.cumsum(found.speed[part] * np.gradient(found.time[part])) - found.theta[part]
    slip -= slip[0] + np.linspace(0.0, 1.0, 2000) * (slip[-1] - slip[0])
    assert slip_of(found.time[part], found.speed[part], found.theta[part], 1) == pytest.approx(
        slip, abs=1e-9)
    assert roughness(found.speed[part]) == pytest.approx(np.diff(found.speed[part]).std())
    read, length = travels(found.time, found.speed, found.theta)
    assert read == pytest.approx(
        0.5 * (found.speed[1:] + found.speed[:-1]) @ np.diff(found.time))
    assert length == pytest.approx(np.abs(np.diff(theta)).sum())


def test_numbers_of_a_section_are_those_of_plain_formulas(runs, nominal):
    found = drive_signals(runs[""], nominal)
    part = slice(20_000, 22_005)
    q, speed, lag = found.torque_current[part], found.speed[part], found.lag[part]
    slopes = [np.polyfit(found.position[part] - found.position[part].mean(), x, 1)[0]
              for x in (q, lag)]
    assert section_numbers(found.rows, part.start, part.stop) == pytest.approx(
        (q.mean(), speed.mean(), lag.mean(), *slopes), rel=1e-9)
    smooth = speed[:2000].reshape(-1, 8).mean(axis=1)
    assert spreads(found.rows, part.start, part.stop) == pytest.approx(
        [np.diff(x).std() for x in (q, speed, smooth, *found.error[part].T)], rel=1e-9)


def test_means_between_edges_are_carried_over_empty_steps():
    values, bounds = np.array([1.0, 2.0, 4.0, 8.0]), np.array([0, 0, 2, 2, 4])
    assert between_edges(values, bounds, True).tolist() == [1.0, 1.5, 1.5, 6.0]
    assert between_edges(values, bounds, False).tolist() == [0.0, 1.5, 0.0, 6.0]


def test_lines_of_several_signals_are_those_of_plain_sums():
    """Folding into bins of a turn and one transform give the sums, but for the bins' width."""
    rng = np.random.default_rng(0)
    theta = np.cumsum(rng.uniform(0.5, 1.5, 6000)) * TURN / 2048.0
    turns = turns_of(np.round(theta * 2048.0 / TURN) * TURN / 2048.0, slice(0, 6000))
    values = rng.normal(size=(len(turns.theta), 3)) + np.cos(turns.theta)[:, None]
    beyond = turns.theta - turns.theta[0]
    middle = turns.window @ beyond
    slope = turns.window @ ((beyond - middle)[:, None] * values) / (
        turns.window @ (beyond - middle) ** 2)
    rest = values - turns.window @ values - (beyond - middle)[:, None] * slope
    plain = [np.exp(-1j * h * turns.theta) @ (turns.window[:, None] * rest) for h in range(1, 9)]
    found = lines(turns, values, 8)
    assert np.abs(found[1:] - plain).max() < 1e-9
    assert np.abs(found[0] - turns.share @ values).max() < 1e-9


def test_too_little_travel_has_no_lines():
    assert turns_of(np.linspace(0.0, 0.5 * TURN, 1000), slice(0, 1000)) is None


def test_segments_of_the_default_test(nominal):
    segments = plan(load_profile("extended"), nominal).segments
    moving = [(s.kind, round(s.speed)) for s in segments if s.kind != "hold"]
    assert moving == [("slew", 791), ("slew", -791), ("slew", 197), ("slew", -197),
                      ("ramp", 25), ("ramp", -25)]


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_what_is_fast_goes_by_the_speed_limit(nominal, share):
    limit = share * nominal.control.speed_limit
    actuator = nominal._replace(control=nominal.control._replace(speed_limit=limit))
    found = plan(default_profiles(actuator)["extended"], actuator)
    kinds = {(round(abs(s.speed) / limit, 2), s.kind) for s in found.segments}
    assert kinds == {(1.0, "slew"), (0.25, "slew"), (0.03, "ramp"), (0.0, "hold")}
    assert all(t.stepped == (abs(t.after - t.before) > 0.4 * limit and t.kind != "stop")
               for t in found.transitions)


@pytest.mark.parametrize("name", profile_names())
def test_every_profile_has_segments_or_changes(name, nominal):
    found = plan(load_profile(name), nominal)
    assert found.segments
    assert found.transitions
    assert all(s.end > s.begin for s in found.segments)


def test_converter_step_is_the_smallest_difference():
    step = 2.0 / 2**14
    values = step * np.random.default_rng(0).integers(-50, 50, 500)
    assert converter_step(values) == pytest.approx(step)
    assert converter_step(np.ones(10)) == 0.0


def test_the_vector_is_finite_and_named(runs, nominal):
    fmap = feature_map(load_profile("extended"), nominal, runs[""])
    vector = fmap.extract(runs[""])
    assert len(vector) == len(fmap.features) == len({f.name for f in fmap.features})
    assert np.isfinite(vector).all()


def test_an_offset_shows_in_its_own_feature(runs, nominal):
    fmap = feature_map(load_profile("extended"), nominal, runs[""])
    at = [f.name for f in fmap.features].index("offset_b")
    assert fmap.extract(runs["offset"])[at] == pytest.approx(0.3, abs=0.02)
    offset = drive_signals(runs["offset"], nominal).offset
    assert offset == pytest.approx([0.0, 0.3, 0.0], abs=0.02)


def test_cogging_shows_as_its_torque_line(runs, nominal):
    fmap = feature_map(load_profile("extended"), nominal, runs[""])
    names = [f.name for f in fmap.features]
    slow = next(s.name for s in fmap.plan.segments if s.kind == "slew" and abs(s.speed) < 300)
    vectors = {k: fmap.extract(r) for k, r in runs.items()}
    size = {k: 2e-3 * math.hypot(*(v[names.index(f"{slow}.torque_line_12_{p}")]
                                   for p in ("re", "im"))) for k, v in vectors.items()}
    # The motor torque that balances it; the shaft moves along a little.
    assert size["cogging"] == pytest.approx(0.02, rel=0.3)
    assert size[""] < 0.002


def test_a_motor_of_several_pole_pairs_shows_what_comes_once_a_turn_of_the_rotor(nominal):
    """Run-out of the speed sensor: line 1 of the rotor is a quarter of the electrical one."""
    actuator = nominal._replace(motor=nominal.motor._replace(pole_pairs=4))
    profile = load_profile("extended")
    quiet, bent = (simulate(profile, actuator=actuator, effects=parse_effects(e), seed=3)
                   for e in ((), ("speed_sensor_runout.amplitude=0.02",)))
    fmap = feature_map(profile, actuator, quiet)
    names = [f.name for f in fmap.features]
    slew = max((s for s in fmap.plan.segments if s.kind == "slew"), key=lambda s: abs(s.speed))
    at = [names.index(f"{slew.name}.turn_speed_line_1_{p}") for p in ("re", "im")]
    assert 2.0 * math.hypot(*fmap.extract(bent)[at]) == pytest.approx(
        0.02 * abs(slew.speed), rel=0.3)
    assert 2.0 * math.hypot(*fmap.extract(quiet)[at]) < 0.002 * abs(slew.speed)
    orders = {int(n.split("_")[3]) for n in names if n.startswith(f"{slew.name}.turn_torque_line")}
    assert orders == {1, 2, 3, 5, 6, 7, 9, 15, 17}
    assert not any("turn_" in f.name for f in feature_map(profile, nominal, quiet).features)
