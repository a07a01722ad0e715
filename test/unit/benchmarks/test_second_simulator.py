"""The benchmark's own simulator against closed forms, and against the product's at the end."""

import ast
import math
from pathlib import Path

import numpy as np
import pytest

import benchmarks.any_actuator
from benchmarks.any_actuator import physics
from benchmarks.any_actuator.described import Damage, Own, Surroundings
from benchmarks.any_actuator.physics import rotor_table, run, shape, steps_of
from benchmarks.any_actuator.records import BenchTest, record_of
from ema_record.actuator import FOC, HARMONICS, INSTANT, PWM, RELAY, load_actuator
from ema_record.channels import ROTOR_ANGLE
from ema_record.profile import step_profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate

pytestmark = pytest.mark.slow  # compiles the second simulator

QUIET = Surroundings(noise=(0.0, 0.0, 0.0))
TURN = 2.0 * math.pi


@pytest.fixture(scope="module")
def nominal():
    return load_actuator()


@pytest.fixture(scope="module")
def step():
    return step_profile(0.8)


def free(a):
    """Return the actuator without friction, load or lost motion."""
    none = {"viscous_friction": 0.0, "dynamic_friction": 0.0, "static_friction": 0.0}
    return a._replace(motor=a.motor._replace(**none), surface=a.surface._replace(**none),
                      shaft=a.shaft._replace(backlash=0.0))


def modulated(a, kind):
    """Return the actuator with a modulated drive of 1.5 kHz bandwidth."""
    reach = TURN * 1500.0
    return a._replace(drive=a.drive._replace(
        kind=kind, pwm_frequency=40e3, proportional_gain=reach * a.motor.phase_inductance,
        integral_gain=reach * a.motor.phase_resistance))


def test_it_shares_no_module_with_the_product_s_simulator():
    folder = Path(benchmarks.any_actuator.__file__).parent
    for name in ("described", "physics", "records", "units"):
        tree = ast.parse((folder / f"{name}.py").read_text(encoding="utf-8"))
        imported = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
        imported |= {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        assert not [m for m in imported if m.startswith(("ema_sim", "ema_prognostics"))]


def test_current_of_a_locked_rotor(nominal, step):
    motor = nominal.motor._replace(static_friction=1e3, dynamic_friction=1e3)
    a = nominal._replace(
        motor=motor, inverter=nominal.inverter._replace(current_limit=500.0, hysteresis=0.05))
    samples, _, _ = run(a, step, s=QUIET._replace(start_angle=math.radians(60.0)))
    time, now = samples[:, 0] - 0.022, samples[:, 2]
    rest = a.inverter.bus_voltage / motor.phase_resistance
    part = (time > 1e-4) & (time < 0.01)
    expected = rest * -np.expm1(-time[part] * motor.phase_resistance / motor.phase_inductance)
    assert now[part] == pytest.approx(expected, abs=0.005 * rest)
    assert samples[part, 3] == pytest.approx(-expected, abs=0.005 * rest)
    assert np.all(samples[part, 1] == 0.0)


@pytest.mark.parametrize("averaged", [False, True])
@pytest.mark.parametrize("kind", [0, PWM, FOC])
def test_steady_slew(nominal, step, kind, averaged):
    """Mean torque = friction: 2 k I with blocks of 120°, 3/2 k I with sines."""
    a = modulated(nominal, kind) if kind else nominal
    if kind == FOC:
        a = a._replace(motor=a.motor._replace(back_emf=HARMONICS))
    samples, bus, _ = run(a, step, s=QUIET, averaged=averaged)
    part = (samples[:, 0] > 0.15) & (samples[:, 0] < 0.37)
    m, x, ratio, omega = a.motor, a.surface, a.gear.ratio, a.control.speed_limit
    assert samples[part, 1].mean() == pytest.approx(omega, rel=1e-3)
    torque = m.dynamic_friction + m.viscous_friction * omega + (
        x.dynamic_friction + x.viscous_friction * omega / ratio) / ratio
    angle = samples[part, 8][:, None] - np.arange(3) * TURN / 3.0
    table = rotor_table(a, Own(), Damage(), 20.0)
    k = np.interp(angle % TURN, np.linspace(0.0, TURN, len(table)), table[:, 0])
    assert (k * samples[part, 2:5]).sum(axis=1).mean() == pytest.approx(torque, rel=0.01)
    amplitude = np.abs(samples[part, 5:8]).max(axis=1).mean()
    if kind == FOC:
        dq = 2.0 / 3.0 * (samples[part, 2:5] * np.sin(angle)).sum(axis=1).mean()
        assert 1.5 * m.back_emf_constant * dq == pytest.approx(torque, rel=0.01)
    else:
        assert 2.0 * m.back_emf_constant * amplitude > torque  # some is lost in commutation
    copper = m.phase_resistance * (samples[part, 2:5] ** 2).sum(axis=1).mean()
    power = 2.0 * a.inverter.bus_voltage * bus[part].mean()
    assert power == pytest.approx(copper + torque * omega, rel=0.02)


def test_acceleration_gives_the_inertia(nominal, step):
    a = free(nominal)
    samples, _, _ = run(a, step, s=QUIET)
    part = (samples[:, 0] > 0.0225) & (samples[:, 0] < 0.025)
    rate = np.polyfit(samples[part, 0], samples[part, 1], 1)[0]
    angle = samples[part, 8][:, None] - np.arange(3) * TURN / 3.0
    table = rotor_table(a, Own(), Damage(), 20.0)
    k = np.interp(angle % TURN, np.linspace(0.0, TURN, len(table)), table[:, 0])
    torque = (k * samples[part, 2:5]).sum(axis=1).mean()
    assert torque == pytest.approx(2.0 * a.motor.back_emf_constant * a.inverter.current_limit,
                                   rel=0.05)
    inertia = a.motor.inertia + a.surface.inertia / a.gear.ratio**2
    assert rate == pytest.approx(torque / inertia, rel=0.02)


@pytest.mark.parametrize("kind", [0, PWM, FOC])
def test_energy_is_kept_to_first_order(nominal, kind):
    """Drawn = copper + motion; motion = friction + damping + what is left; error as the step."""
    a = modulated(nominal, kind) if kind else nominal
    a = a._replace(surface=a.surface._replace(static_friction=a.surface.dynamic_friction),
                   motor=a.motor._replace(static_friction=a.motor.dynamic_friction))
    errors = []
    for longest in (2e-6, 0.5e-6):
        _, _, e = run(a, step_profile(0.3, duration=0.15), s=QUIET, longest=longest)
        assert e[0] == pytest.approx(e[1] + e[2], rel=2e-3)  # the rest is in the inductances
        errors.append(abs(e[2] - e[3] - e[4] - e[5]) / e[2])
    assert errors[1] < 1e-4
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize("kind", [PWM, FOC])
def test_switching_agrees_with_its_average(nominal, step, kind):
    a = modulated(nominal, kind)
    one, two = (run(a, step, s=QUIET, averaged=averaged)[0] for averaged in (False, True))
    part = (one[:, 0] > 0.15) & (one[:, 0] < 0.37)
    assert np.abs(one[part, 2:5]).mean() == pytest.approx(np.abs(two[part, 2:5]).mean(), rel=0.01)
    assert one[part, 9] == pytest.approx(two[part, 9], abs=1e-3)


def test_dead_time_costs_voltage(nominal, step):
    """A locked rotor at constant current: the demand rises by 2 V t_d f a leg."""
    a = modulated(nominal, PWM)
    a = a._replace(motor=a.motor._replace(static_friction=1e3, dynamic_friction=1e3))
    _, bus, _ = run(a, step, s=QUIET)
    _, lossy, _ = run(a, step, Own(dead_time=1e-6), QUIET)
    copper = 2.0 * a.motor.phase_resistance * a.inverter.current_limit**2
    power = 2.0 * a.inverter.bus_voltage * bus[-2000:].mean()
    assert power == pytest.approx(copper, rel=0.02)
    assert lossy[-2000:].mean() == pytest.approx(bus[-2000:].mean(), rel=0.02)  # the same current


def test_friction_holds_and_lets_go(nominal, step):
    a, off = nominal, step.model_copy(update={"inverter_off": 0.45})
    whole = a.surface.static_friction + a.gear.ratio * a.motor.static_friction
    still = run(a, off, s=QUIET._replace(load=0.99 * a.surface.static_friction))[0]
    assert np.ptp(still[:, 9]) < 1e-9
    moved = run(a, off, s=QUIET._replace(load=2.0 * whole))[0]
    assert moved[-1, 9] > a.surface.end_stop - 1e-6  # up to its end stop, and no further
    assert moved[:, 9].max() <= a.surface.end_stop + 1e-12


def test_shape_of_the_back_emf(nominal):
    angle = np.linspace(0.0, TURN, 2048, endpoint=False)
    sharp, blurred = shape(nominal, 0.0, angle), shape(nominal, 0.15, angle)
    assert sharp[512] == pytest.approx(1.0)
    assert np.interp(math.radians(15.0), angle, sharp) == pytest.approx(0.5, abs=1e-3)
    # Fundamental of a trapezoid of edges of half width g: 4 sin(g) / (π g); a blur damps line n.
    line, g = np.fft.rfft(sharp) / 1024, 0.5 * (math.pi - nominal.motor.flat_top)
    assert -line[1].imag == pytest.approx(4.0 * math.sin(g) / (math.pi * g), rel=1e-4)
    assert -np.fft.rfft(blurred)[3].imag / 1024 == pytest.approx(
        -line[3].imag * math.exp(-0.5 * (3 * 0.15) ** 2), rel=1e-6)


def test_what_faults_do_to_the_rotor(nominal):
    a = nominal._replace(motor=nominal.motor._replace(pole_pairs=3))
    sound = rotor_table(a, Own(), Damage(), 20.0)
    short = rotor_table(a, Own(), Damage(short=0.1, phase=1), 20.0)
    assert short[:, 1] == pytest.approx(0.9 * sound[:, 1])
    assert short[:, [0, 2]] == pytest.approx(sound[:, [0, 2]])
    theta = np.linspace(0.0, TURN, len(sound))
    for shifted in (False, True):
        off = rotor_table(a, Own(), Damage(eccentricity=0.02, angle=0.3, shifted=shifted), 20.0)
        for n in range(3):
            gap = 1.0 + 0.02 * np.cos(theta - 0.3 - (n * TURN / 3.0 if shifted else 0.0))
            assert off[:, n] == pytest.approx(gap * sound[:, n])
    assert rotor_table(a, Own(), Damage(), 120.0) == pytest.approx(0.89 * sound)


def test_acquisition_as_described(nominal, step):
    def at(**changed):
        return nominal._replace(acquisition=nominal.acquisition._replace(**changed))

    mean = run(nominal, step, s=QUIET)[0]
    end = run(at(sampling=INSTANT, time_at=1.0), step, s=QUIET)[0]
    assert mean[:3, 0] == pytest.approx([2.5e-5, 7.5e-5, 12.5e-5])
    assert end[:3, 0] == pytest.approx([5e-5, 1e-4, 1.5e-4])
    part = slice(2000, 6000)
    middle = 0.5 * (end[:-1, 9] + end[1:, 9])
    assert mean[1:, 9][part] == pytest.approx(middle[part], abs=1e-6)
    late = run(at(command_latency=2.0), step, s=QUIET)[0]
    first = [np.argmax(np.abs(x[:, 5:8]).max(axis=1) > 10.0) for x in (mean, late)]
    assert first[1] - first[0] == 2
    slow = run(at(reference_latency=2.0), step, s=QUIET)[0]
    first = [np.argmax(np.abs(x[:, 2:5]).max(axis=1) > 2.0) for x in (mean, slow)]
    assert first[1] - first[0] == 2
    assert np.abs(mean[:390, 2:8]).max() == 0.0  # the inverter is off


@pytest.mark.parametrize(("period", "rate"), [
    (50e-6, 20e3), (100e-6, 2e3), (125e-6, 12e3), (62.5e-6, 50e3), (200e-6, 24e3)])
def test_steps_fit_control_period_and_sample(nominal, period, rate):
    a = nominal._replace(control=nominal.control._replace(period=period),
                         acquisition=nominal.acquisition._replace(rate=rate))
    n, m = steps_of(a, 1e-6)
    assert period / n == pytest.approx(1.0 / rate / m, rel=1e-12)
    assert period / n <= 1e-6


def test_noise_and_converters_of_a_record(nominal, step):
    test = BenchTest(nominal, Own(), Surroundings(), Damage(), 5, "B")
    record, again = record_of(test, step), record_of(test, step)
    assert np.array_equal(record.samples, again.samples)
    off = record.samples[:390]
    assert off[:, 1].std() == pytest.approx(nominal.noise.speed, rel=0.15)
    assert off[:, 2:5].std() == pytest.approx(nominal.noise.current, rel=0.15)
    bit = nominal.converters.position_range / 2.0**nominal.converters.position_bits
    assert record.samples[:, 9] / bit == pytest.approx(np.rint(record.samples[:, 9] / bit))
    assert record.dc_bus[:, 1] == pytest.approx(2.0 * nominal.inverter.bus_voltage)


def test_agreement_with_the_product_s_simulator(nominal, step):
    """Mean current and speed of the default actuator within 0.5 %, position within 0.2 mrad."""
    ours = record_of(BenchTest(nominal, Own(), QUIET, Damage(), 1, "B"), step)
    theirs = simulate(step, actuator=nominal, noise=0.0)
    part = (ours.time > 0.1) & (ours.time < 0.38)
    for channel in ("motor_speed", "phase_current_a", "phase_current_b", "phase_current_c"):
        one, two = (np.abs(r.channel(channel)[part]).mean() for r in (ours, theirs))
        assert one == pytest.approx(two, rel=0.005)
    gap = ours.channel("surface_position")[part] - theirs.channel("surface_position")[part]
    assert np.abs(gap).max() < 2e-4
    assert ours.dc_bus[1:3, 2] == pytest.approx(theirs.dc_bus[1:3, 2], rel=0.01)


@pytest.mark.parametrize("kind", [RELAY, PWM, FOC])
def test_agreement_on_late_commutation(nominal, step, kind):
    """What it does to the currents; the product turns an angle, ours is a true delay of it."""
    a, found = nominal if kind == RELAY else modulated(nominal, kind), []
    for latency in (4.0, 0.0):
        late = a._replace(acquisition=a.acquisition._replace(commutation_latency=latency))
        found.append([])
        for record in (record_of(BenchTest(late, Own(), QUIET, Damage(), 1, "B"), step),
                       simulate(step, actuator=late, noise=0.0)):
            part = record.samples[(record.time > 0.1) & (record.time < 0.38)]
            wave = np.exp(-1j * part[:, ROTOR_ANGLE])
            found[-1].append((np.angle((wave * part[:, 2]).sum() / (wave * part[:, 5]).sum()),
                              np.log(np.abs(part[:, 2:5]).mean())))
    ours, theirs = np.subtract(*found)
    lag = 4.0 * a.motor.pole_pairs * a.control.period * a.control.speed_limit
    assert ours[0] == pytest.approx(-lag, rel=0.1)
    assert ours[0] == pytest.approx(theirs[0], rel=0.05)  # they control each phase otherwise
    assert ours[1] == pytest.approx(theirs[1], abs=0.02)


@pytest.mark.parametrize("kind", [RELAY, PWM])
def test_agreement_on_a_weak_source(nominal, step, kind):
    """The fall of the bus, and what it does to speed and ripple, within a tenth of itself."""
    a = nominal if kind == RELAY else modulated(nominal, kind)
    sag, found = 1.0, []  # with 1 mF its capacitor is as slow as the other one, 1 ms
    for r in (sag, 0.0):
        ours = record_of(BenchTest(a, Own(), QUIET, Damage(sag=r), 1, "B"), step)
        theirs = simulate(step, actuator=a, noise=0.0, effects=parse_effects(
            [f"bus_voltage_sag.resistance={r}"]))
        found.append([])
        for record in (ours, theirs):
            steady = (record.time > 0.15) & (record.time < 0.38)
            current = record.channel("phase_current_a")[steady]
            found[-1].append((record.dc_bus[1:, 1].min(), record.channel("motor_speed")[
                record.time < 0.03].max(), np.log(np.diff(current).std())))
    weak, strong = np.array(found)
    ours, theirs = weak - strong
    assert ours[0] == pytest.approx(theirs[0], rel=0.1)
    assert ours[0] < -1.0
    assert ours[1] == pytest.approx(theirs[1], rel=0.1, abs=1.0)
    assert ours[2] == pytest.approx(theirs[2], abs=0.05)


def test_the_equations_can_be_read_in_one_sitting():
    lines = Path(physics.__file__).read_text(encoding="utf-8").count("\n")
    assert lines <= 350
