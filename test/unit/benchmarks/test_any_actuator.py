"""Machines, units, cases and table of the benchmark of any actuator."""

import json
import math

import numpy as np
import pytest

from benchmarks.any_actuator.cases import (
    CLASS,
    LARGEST,
    SENSOR_FAULTS,
    STRANGERS,
    TEST,
    Counts,
    draw_cases,
    sizes_of,
    turnable,
    usual_sizes,
)
from benchmarks.any_actuator.described import Damage, Own
from benchmarks.any_actuator.machines import load_machine, machine_names
from benchmarks.any_actuator.physics import run
from benchmarks.any_actuator.records import BenchTest, record_of
from benchmarks.any_actuator.strangers import told_together, whitened_shifts
from benchmarks.any_actuator.table import is_right, markdown, rates
from benchmarks.any_actuator.units import (
    draw_own,
    draw_surroundings,
    draw_test,
    draw_type,
    draw_unit,
)
from ema_record.actuator import (
    FOC,
    HARMONICS,
    INSTANT,
    PWM,
    PWM_INDEPENDENT,
    RELAY,
    load_actuator,
)
from ema_record.profile import load_profile_dict
from ema_record.spread import load_spread

MACHINES = machine_names()


@pytest.fixture(scope="module")
def loaded():
    return {name: load_machine(name) for name in MACHINES}


def share_step(a, seconds, hold):
    """Return a step of so many seconds at full slew, and then a while."""
    half = 0.5 * seconds * a.slew_speed
    return load_profile_dict({"name": "slew", "points": [
        [0.0, -half], [0.03, -half], [0.03, half], [0.03 + seconds + hold, half]]}, "slew")


def test_six_machines_as_the_issue_wants_them(loaded):
    actuators = [m.actuator for m in loaded.values()]
    assert len(actuators) == 6
    for kind, machines in ((RELAY, 2), (PWM, 1), (PWM_INDEPENDENT, 1), (FOC, 2)):
        assert sum(a.drive.kind == kind for a in actuators) == machines
    supplies = {2.0 * a.inverter.bus_voltage: a for a in actuators}
    assert (supplies[12.0].motor.pole_pairs, supplies[12.0].gear.ratio) == (4, 30.0)
    assert supplies[270.0].gear.ratio == 1200.0
    assert {min(a.acquisition.rate for a in actuators),
            max(a.acquisition.rate for a in actuators)} == {2e3, 5e4}
    assert sum(a.motor.back_emf == HARMONICS for a in actuators) >= 2
    assert sum(a.acquisition.sampling == INSTANT for a in actuators) == 1
    assert sum(not a.acquisition.converters for a in actuators) == 1
    assert sum(not (a.acquisition.phase_current_c or a.acquisition.reference_currents)
               for a in actuators) == 1


@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_makes_physical_sense(loaded, name):
    a, spread = loaded[name].actuator, loaded[name].spread
    m, x, ratio, omega = a.motor, a.surface, a.gear.ratio, a.control.speed_limit
    constant = (1.5 if a.drive.kind == FOC else 2.0) * m.back_emf_constant
    most = constant * a.inverter.current_limit
    moving = m.dynamic_friction + m.viscous_friction * omega + (
        x.dynamic_friction + x.viscous_friction * omega / ratio) / ratio
    assert most / moving >= 2.0
    assert most / (m.static_friction + x.static_friction / ratio) >= 2.0
    assert m.torque_limit >= most
    needed = m.back_emf_constant * omega + m.phase_resistance * moving / constant
    assert a.inverter.bus_voltage / needed >= 1.3
    turning = m.pole_pairs * omega / (2.0 * math.pi)
    assert a.acquisition.rate / turning >= 24.0
    assert 2.0 * x.end_stop / a.slew_speed > 0.3  # s at full slew
    assert spread.conditions.load < x.dynamic_friction  # it stays where it is
    c = a.converters
    assert 0.5 * c.speed_range > 1.1 * omega
    assert 0.5 * c.position_range > 1.05 * x.end_stop
    assert 0.5 * c.current_range > 1.2 * a.inverter.current_limit


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_follows_a_step_and_stands(loaded, name):
    """Slew speed within 0.5 %, overshoot below 2 %, arrives within 2 % of the step, at rest."""
    a = loaded[name].actuator
    loop = a.gear.ratio / a.control.position_gain
    profile = share_step(a, 0.3, 8.0 * loop + 0.2)
    samples, _, _ = run(a, profile)
    omega, time = a.control.speed_limit, samples[:, 0]
    slewing = (time > 0.15) & (time < 0.25)
    assert samples[slewing, 1].mean() == pytest.approx(omega, rel=5e-3)
    assert samples[:, 1].max() < 1.02 * omega
    end = time > profile.duration - 0.1
    half = profile.points[-1][1]
    assert samples[end, 9] == pytest.approx(half, abs=0.02 * half)
    assert np.abs(samples[end, 1]).mean() < 0.03 * omega


@pytest.mark.slow
def test_channels_that_are_not_recorded_are_not_there(loaded):
    a = next(m.actuator for m in loaded.values() if not m.actuator.acquisition.phase_current_c)
    test = draw_test(a, load_spread().tolerances, load_spread().conditions, (1, 2), 0, Damage(),
                     own=True)
    samples = record_of(test, share_step(a, 0.05, 0.05)).samples
    absent = np.isnan(samples).all(axis=0)
    assert absent.tolist() == [False] * 4 + [True] * 4 + [False] * 2
    assert np.isfinite(samples[:, ~absent]).all()


def test_units_repeat_by_seed_and_differ_in_everything():
    a, spread = load_actuator(), load_spread()
    one, again, other = (
        draw_unit(a, spread.tolerances, (1, place)) for place in (2, 2, 3))
    assert one == again
    spread_over = {
        "motor": ("phase_resistance", "phase_inductance", "back_emf_constant", "flat_top",
                  "back_emf_deviation_a", "inertia", "viscous_friction", "dynamic_friction",
                  "static_friction"),
        "surface": ("inertia", "viscous_friction", "dynamic_friction", "static_friction"),
        "shaft": ("stiffness", "damping", "backlash"), "inverter": ("hysteresis",),
        "control": ("position_gain", "proportional_gain", "integral_gain"),
        "acquisition": ("command_latency", "reference_latency"),
    }
    for section, names in spread_over.items():
        for name in names:
            values = {getattr(getattr(u, section), name) for u in (a, one, other)}
            assert len(values) == 3, name
    assert draw_own(a, (1, 2)) == draw_own(a, (1, 2)) != Own()
    assert draw_own(a, (1, 2)).dead_time == 0.0  # relays have none here
    assert draw_surroundings(spread.conditions, (1, 2)) != draw_surroundings(
        spread.conditions, (1, 3))


def test_units_stay_within_their_tolerances():
    a, spread = load_actuator(), load_spread()
    units = [draw_unit(a, spread.tolerances, (7, n)) for n in range(200)]
    viscous = np.array([u.motor.viscous_friction for u in units]) / a.motor.viscous_friction
    assert 0.5 <= viscous.min() < 0.55
    assert 1.85 < viscous.max() <= 2.0
    assert np.median(viscous) == pytest.approx(1.0, abs=0.1)  # even in its logarithm
    assert all(u.surface.static_friction >= u.surface.dynamic_friction for u in units)
    late = np.array([u.acquisition.command_latency for u in units])
    assert 0.0 <= late.min() < 0.1 < 1.9 < late.max() <= spread.tolerances.latency


def test_a_fleet_holds_what_it_should():
    a, spread = load_actuator(), load_spread()
    counts = Counts(units=3, healthy=5, each_fault=4, strangers=7, sensor_faults=4)
    draw = {"seed": 3, "fleet": TEST, "duration": 3.0, "own": True}
    cases = draw_cases(a, spread, counts, usual_sizes(a), **draw)
    assert cases == draw_cases(a, spread, counts, usual_sizes(a), **draw)
    assert len({c.key for c in cases}) == len(cases) == 5 + 4 * len(CLASS) + 7 + 4
    assert len({c.test.actuator for c in cases}) == 3
    assert len({c.test.seed for c in cases}) == len(cases)
    assert {c.detail for c in cases if c.group == "stranger"} == set(STRANGERS)
    assert {c.detail for c in cases if c.group == "sensor"} == set(SENSOR_FAULTS)
    for c in cases:
        assert (c.test.damage == Damage()) == (c.group == "healthy")
    short = next(c for c in cases if c.group == "turn_short")
    assert short.phase == "abc"[short.test.damage.phase]
    others = draw_cases(a, spread, counts, usual_sizes(a), **{**draw, "fleet": TEST + 1})
    assert not {c.test.actuator for c in cases} & {c.test.actuator for c in others}


def test_sizes_are_those_that_the_kit_gives(tmp_path):
    a = load_actuator()
    assert sizes_of(a, tmp_path) == usual_sizes(a)
    (tmp_path / "validation.json").write_text(json.dumps({
        "profile": "extended", "held_out": {"extended": {"fleet": {
            "turn_short": {"a90": 0.02}, "friction": {"a90": 0.3}, "backlash": {"a90": None}}}}}))
    sizes = sizes_of(a, tmp_path, 2.0)
    assert sizes["turn_short"] == 0.04
    assert sizes["motor_friction"] == sizes["surface_friction"] == 0.6
    assert sizes["backlash"] == usual_sizes(a)["backlash"]


def row(group, outcome, named=(), **more):
    return {"group": group, "detail": "", "size": 0.1, "phase": None, "outcome": outcome,
            "named": list(named), "alternatives": [], "named_phase": None, "interval": None,
            "reasons": [], **more}


def test_rates_of_the_table():
    rows = [
        *(row("healthy", "healthy") for _ in range(98)), row("healthy", "unknown"),
        row("healthy", "fault", ["friction"]),
        row("turn_short", "fault", ["turn_short"], phase="a", named_phase="a",
            interval=[0.09, 0.11]),
        row("turn_short", "fault", ["turn_short"], phase="a", named_phase="b",
            interval=[0.2, 0.3]),
        row("motor_friction", "fault", ["backlash"]), row("backlash", "unknown"),
        row("stranger", "healthy"), row("sensor", "invalid"),
    ]
    found = rates(rows)
    assert found["healthy called a fault"][:2] == (1, 100)
    assert found["healthy called a fault"].upper == pytest.approx(0.0545, abs=1e-4)
    assert found["healthy called unknown"][:2] == (1, 100)
    assert found["right class"][:2] == (2, 4)
    assert found["right phase"][:2] == (1, 2)
    assert found["severity in its interval"][:2] == (1, 2)
    assert found["strangers and sensor faults not told"][:2] == (1, 2)
    assert is_right(row("motor_friction", "fault", ["turn_short"], alternatives=["friction"]))
    text = markdown({"one": rows, "two": rows})
    assert "| 2 of 200" in text
    assert "**2 of 4" in text  # short of its target


@pytest.mark.slow
def test_a_fault_shows_in_the_record(loaded):
    """A surface with twice the friction needs as much more current as its share of the torque."""
    a = load_machine(MACHINES[0]).actuator
    profile = share_step(a, 0.3, 0.1)
    current = []
    for increase in (0.0, 1.0):
        test = BenchTest(a, Own(), draw_surroundings(
            load_machine(MACHINES[0]).spread.conditions, (1, 1))._replace(
                load=0.0, noise=(0.0, 0.0, 0.0), temperature=20.0),
            Damage(surface_friction=increase), 1, "B")
        record = record_of(test, profile)
        part = (record.time > 0.15) & (record.time < 0.25)
        current.append(np.abs(record.samples[part, 5:8]).max(axis=1).mean())
    x, m, ratio = a.surface, a.motor, a.gear.ratio
    dry, omega = x.dynamic_friction / ratio, a.control.speed_limit
    before = m.dynamic_friction + dry + m.viscous_friction * omega + (
        x.viscous_friction * omega / ratio**2)
    assert current[1] / current[0] == pytest.approx(1.0 + dry / before, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("group", ["motor_friction", "surface_friction"])
def test_a_friction_is_at_most_what_the_unit_can_turn(group):
    """With that much it slews; with that and three tenths of all torque more it does not."""
    machine = load_machine("valve_12v")
    a, profile = machine.actuator, share_step(machine.actuator, 0.3, 0.1)
    cases = [c for c in draw_cases(
        a, machine.spread, Counts(units=3, healthy=0, each_fault=3, strangers=0, sensor_faults=0),
        {**usual_sizes(a), group: LARGEST}, seed=5, fleet=TEST, duration=profile.duration,
        own=True) if c.group == group]
    assert any(c.size < LARGEST for c in cases)
    for case in cases:
        most = turnable(case.test, group)
        assert case.size == min(most, LARGEST) == getattr(case.test.damage, group)
        speeds = []
        for size in (most, 1.3 * (most + 2.0)):
            test = case.test._replace(damage=Damage(**{group: size}))
            record = record_of(test, profile)
            part = (record.time > 0.15) & (record.time < 0.25)
            speeds.append(record.samples[part, 1].mean() / a.control.speed_limit)
        assert speeds[0] > 0.95
        assert speeds[1] < 0.9


def test_sensors_fail_that_are_recorded():
    machine = load_machine("rudder_160v")
    cases = draw_cases(
        machine.actuator, machine.spread,
        Counts(units=20, healthy=0, each_fault=0, strangers=0, sensor_faults=20), {}, seed=5,
        fleet=TEST, duration=1.0, own=True)
    assert {c.test.damage.phase for c in cases} == {0, 1}


def test_a_type_is_off_its_description():
    a = load_actuator()
    types = [draw_type(a, (7, n)) for n in range(100)]
    dry = np.array([t.surface.dynamic_friction for t in types]) / a.surface.dynamic_friction
    assert 1.0 / 1.3 <= dry.min() < 0.82 < 1.2 < dry.max() <= 1.3
    assert all(t.motor.static_friction / t.motor.dynamic_friction == pytest.approx(
        a.motor.static_friction / a.motor.dynamic_friction) for t in types)
    assert all(t.gear == a.gear and t.control == a.control for t in types)


def test_distances_of_strangers_hold_no_error_of_their_own():
    """Means of 200 pairs over 40 features have errors of 0.4; of a known law, and a fault."""
    rng = np.random.default_rng(4)
    root = np.eye(40) + 0.5 * np.eye(40, k=1)
    shift = np.zeros((2, 40))
    shift[0, 3], shift[1, :2] = 2.0, (2.0, 1.0)
    fault = np.zeros((1, 40))
    fault[0, 0] = 5.0
    pairs = np.concatenate([shift, fault]) @ root + rng.standard_normal((200, 3, 40)) @ root
    found = whitened_shifts(rng.standard_normal((800, 40)) @ root, pairs[:, :2], pairs[:, 2:],
                            np.zeros(40))
    assert np.linalg.norm(found[0], axis=1) == pytest.approx([2.0, np.sqrt(5.0)], abs=0.2)
    assert np.linalg.norm(found[1], axis=1) == pytest.approx([2.0, 1.0], abs=0.2)


def test_the_bound_of_one_stranger_is_the_closed_one_and_of_several_is_less():
    from scipy.stats import norm

    one = np.array([[0.0, 2.0, 0.0]])
    closed = norm.cdf(2.0 - norm.ppf(0.97))
    assert told_together(one, np.ones(1), 0.03)[0] == pytest.approx(closed, abs=0.01)
    several = told_together(2.0 * np.eye(3), np.ones(3), 0.03)
    assert (several < closed - 0.1).all()
    assert several == pytest.approx(np.full(3, several.mean()), abs=0.02)  # by symmetry
    far = told_together(np.vstack([one, [[90.0, 0.0, 0.0]]]), np.ones(2), 0.03)
    assert far == pytest.approx([closed, 1.0], abs=0.02)
