"""What is recorded: means or instants, their times, converters, missing channels, latencies."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ema_record.actuator import FOC, INSTANT, MEAN, PWM, RELAY
from ema_record.channels import CHANNEL_NAMES
from ema_record.profile import Profile, step_profile
from ema_sim.effects import parse_effects
from ema_sim.plant import state as st
from ema_sim.session import ActuatorSession
from ema_sim.simulate import simulate
from support.actuators import both_machines, changed
from support.plant import run, state_of

STEP = step_profile(0.05, start=-0.02, duration=0.07)
FREE = {"static_friction": 0.0, "dynamic_friction": 0.0, "viscous_friction": 0.0}


def recorded(seed: int = 2, noise: float = 0.0, profile: Profile = STEP, **acquisition: float):
    """Return a record of a FOC drive, whose course no sample's edge disturbs."""
    a = changed(drive={"kind": FOC}, acquisition=acquisition)
    return simulate(profile, actuator=a, seed=seed, noise=noise)


@both_machines
@pytest.mark.parametrize("at", [0.0, 0.3, 0.5, 1.0])
@pytest.mark.parametrize("sampling", [MEAN, INSTANT], ids=["mean", "instant"])
def test_a_free_rotor_is_where_its_speed_brings_it(sampling, at, machine):
    """A sample holds the angle of its own time.

    The angle is that of the middle of the interval (mean) or of the sample's time (instant);
    the time is where the acquisition says.
    """
    a = changed(machine.actuator, motor=FREE, shaft={"backlash": 0.1},
                acquisition={"sampling": sampling, "time_at": at})
    found = run(a, state_of(a, omega_m=100.0), 0.01, rate=machine.rate).out
    sample = np.arange(len(found))
    assert found[:, 0] == pytest.approx((sample + at) / machine.rate, abs=1e-12)
    when = sample + (0.5 if sampling == MEAN else at)
    expected = 0.3 + a.motor.pole_pairs * 100.0 * when / machine.rate
    assert found[:, 8] == pytest.approx(expected, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("at", [0.0, 0.4, 1.0])
def test_an_instant_is_the_limit_of_short_means(at):
    """An instant is the mean over a very short interval.

    A mean over 1 µs about the instant, to 2 % of the rms: the steps differ, and with them now
    and then the last bit of the speed that the control reads (0.04 A).
    """
    fast = 1_000_000.0
    instant = recorded(sampling=INSTANT, time_at=at, converters=0).samples
    means = recorded(rate=fast, converters=0).samples
    row = np.round(instant[:, 0] * fast - 0.5).astype(int)
    keep = row < len(means)
    for k in range(1, 8):
        error = instant[keep, k] - means[row[keep], k]
        if k in {5, 6, 7} and at in {0.0, 1.0}:
            # On the edge of a control period the reference jumps: new one at 0, old one at 1.
            row_after = np.clip(row[keep] + (1 if at == 0.0 else -1), 0, len(means) - 1)
            error = np.minimum(abs(error), abs(instant[keep, k] - means[row_after, k]))
        scale = np.sqrt(np.mean(means[:, k] ** 2))
        assert np.sqrt(np.mean(error**2)) < 0.02 * scale, CHANNEL_NAMES[k]


def test_the_rate_of_instants_does_not_change_their_current_noise():
    """A mean over twice the time has 1 / √2 of the noise, an instant all of it."""
    for sampling, ratio in ((MEAN, math.sqrt(0.5)), (INSTANT, 1.0)):
        found = [
            recorded(noise=1.0, sampling=sampling, rate=rate, converters=0).samples
            for rate in (20_000.0, 10_000.0)
        ]
        quiet = [s[s[:, 0] < 0.019, 2:5].std() for s in found]  # the inverter is off
        assert quiet[1] / quiet[0] == pytest.approx(ratio, rel=0.1)


def test_without_converters_nothing_is_rounded():
    found, rounded = recorded(converters=0).samples, recorded().samples
    c = changed().converters
    step = np.array([c.speed_range / 2**c.speed_bits] + 6 * [c.current_range / 2**c.current_bits])
    error = rounded[:, 1:8] - found[:, 1:8]
    assert np.all(np.abs(error) <= 0.5 * step * (1 + 1e-9))
    assert np.all(error.std(axis=0)[[0, 1, 2, 3]] > 0.2 * step[:4])
    assert np.all((found[:, 8] >= 0.0) & (found[:, 8] < 2.0 * math.pi))
    assert np.abs(found[:, 2:5].sum(axis=1)).max() < 1e-12, "the sum of the currents"


@pytest.mark.parametrize(("name", "columns"), [
    ("phase_current_c", [4]), ("reference_currents", [5, 6, 7]), ("rotor_angle", [8]),
    ("surface_position", [9]),
])
def test_channels_that_are_not_recorded_are_not_numbers(name, columns):
    """And the others are what they are with them, bit for bit."""
    found, whole = recorded(noise=1.0, **{name: 0}).samples, recorded(noise=1.0).samples
    others = [k for k in range(10) if k not in columns]
    assert np.isnan(found[:, columns]).all()
    assert np.array_equal(found[:, others], whole[:, others])


@pytest.mark.parametrize("periods", [0, 1, 7])
def test_a_command_acts_its_latency_later(periods):
    """Bit for bit what a profile gives that commands the same so many control periods later."""
    period = changed().control.period
    points = ((0.0, 0.0), (0.03, 0.0), (0.03, 0.01), (0.06, -0.01), (0.08, -0.01))
    later = tuple((t + (periods * period if 0.0 < t < 0.08 else 0.0), x) for t, x in points)
    one = recorded(noise=1.0, command_latency=float(periods),
                   profile=Profile(name="now", points=points))
    other = recorded(noise=1.0, profile=Profile(name="later", points=later))
    assert np.abs(one.samples - other.samples).max() < 1e-9
    if periods:
        assert not np.array_equal(one.samples, recorded(
            noise=1.0, profile=Profile(name="now", points=points)).samples)


@pytest.mark.parametrize(("latency", "late"), [(2.25, 2), (1.5, 2), (0.4, 0)])
def test_a_command_acts_from_the_nearest_period_on(latency, late):
    a = changed(acquisition={"command_latency": latency})
    session = ActuatorSession(a, position=0.0)
    session.command(Profile(name="jump", points=((0.0, 0.0), (0.03, 0.0), (0.03, 0.4),
                                                 (0.05, 0.4))))
    first = round(0.03 / a.control.period)
    assert session._commanded(first, 5) == pytest.approx([0.0] * late + [0.4] * (5 - late))


def test_the_latency_goes_on_over_a_new_command():
    """A command that takes the place of another acts as late, the old one until then."""
    a = changed(acquisition={"command_latency": 3.0})
    session = ActuatorSession(a, position=0.0)
    session.command(Profile(name="hold", points=((0.0, 0.0), (1.0, 0.1))))
    session.advance(400)
    session.command(Profile(name="other", points=((0.0, 0.2), (1.0, 0.2))))
    begun = session._asked[-1].first
    ramp = 0.1 * (begun - 3 + np.arange(3)) * a.control.period
    assert session._commanded(begun, 6)[:3] == pytest.approx(ramp, abs=1e-8)
    assert session._commanded(begun, 6)[3:] == pytest.approx(0.2)
    session.command(Profile(name="third", points=((0.0, 0.3), (1.0, 0.3))))
    assert session._commanded(begun, 6)[:3] == pytest.approx(ramp, abs=1e-8)
    assert session._commanded(begun, 6)[3:] == pytest.approx(0.3)


@pytest.mark.parametrize("latency", [0.0, 1.0, 1.9])
def test_the_kernel_is_given_one_type_whatever_is_commanded(latency):
    """An array that can be written is another type, and compiled for it anew: half a minute."""
    session = ActuatorSession(changed(acquisition={"command_latency": latency}), settle=False)
    session.command(STEP)
    first = session._commanded(0, 40)
    session._take(STEP)
    for command in (first, session._commanded(0, 40), session._commanded(30, 2000)):
        assert command.flags.c_contiguous and not command.flags.writeable


@pytest.mark.parametrize("kind", [FOC, RELAY])
@pytest.mark.parametrize(("delay", "latency"), [
    (0.0, 0.0), (3.0, 0.0), (0.0, 4.0), (2.0, 5.0), (0.5, 2.25)])
def test_a_reference_is_recorded_after_its_delay_and_acts_after_its_latency_too(
        delay, latency, kind):
    """Locked rotor: the reference jumps to its limit; record and current show when."""
    a = changed(motor={"static_friction": 1e9, "dynamic_friction": 1e9}, drive={"kind": kind},
                inverter={"current_limit": 7.0}, acquisition={"reference_latency": latency})
    period = a.control.period
    found = run(a, state_of(a, angle=math.pi / 2), 0.02, inverter_on=0.01, command=0.4,
                effects=parse_effects([f"control_delay.delay={delay * period!r}"])).out
    wanted, current = found[:, 5], found[:, 2]
    jump = round(0.01 / period)
    asked = jump + delay
    whole = math.floor(asked)
    assert np.all(wanted[:whole] == 0.0)
    assert wanted[whole] == pytest.approx(7.0 * (1.0 - (asked - whole)), rel=1e-6)
    assert wanted[whole + 1] == pytest.approx(7.0, rel=1e-6)
    acts = asked + latency  # a carrier's period begins with the next one
    acts = math.ceil(acts) if kind == FOC else math.floor(acts)
    assert np.all(np.abs(current[:acts]) < 1e-12)
    assert current[acts] > 0.02


@pytest.mark.parametrize("latency", [0.3, 0.5, 1.74])
def test_a_delay_is_a_shift_in_time(latency):
    """Whatever is limited: a relay's current starts so much later, at the same slope."""
    a = changed(motor={"static_friction": 1e9, "dynamic_friction": 1e9},
                acquisition={"reference_latency": latency})
    now = changed(a, acquisition={"reference_latency": 0.0})
    late, at_once = (
        np.abs(run(x, state_of(x, angle=math.pi / 2), 0.011, inverter_on=0.01, command=0.4,
                   rate=1e6).out[:, 2:5]).max(axis=1) for x in (a, now))
    shift = round(latency * a.control.period * 1e6)
    assert late[10_000 + shift:10_600] == pytest.approx(at_once[10_000:10_600 - shift], abs=0.02)
    assert late[10_000 + shift - 2] < 1e-9 < late[10_000 + shift + 2]


HEAVY = {"inertia": 1e3, "static_friction": 0.0, "dynamic_friction": 0.0}


@pytest.mark.slow
@pytest.mark.parametrize("speed", [100.0, -100.0])
@pytest.mark.parametrize("kind", [RELAY, PWM])
def test_late_commutation_turns_the_currents_on_so_much_later(kind, speed):
    """At a constant speed: a phase that was off begins to carry current, its reference before."""
    a = changed(motor=HEAVY, drive={"kind": kind},
                control={"position_gain": 0.0, "speed_limit": 900.0},
                acquisition={"commutation_latency": 3.0})
    found = run(a, state_of(a, omega_m=speed), 0.05, inverter_on=0.005, rate=1e6).out
    edges = np.flatnonzero((found[:-1, 5] == 0.0) & (found[1:, 5] != 0.0))
    edges = edges[edges > 10_000]
    assert len(edges) >= 1
    on = 1.0  # A, of 22; the band of the relays is half as wide
    for edge in edges:
        first = edge + int(np.argmax(np.abs(found[edge:, 2]) > on))
        late = (first - edge) * 1e-6 / a.control.period
        assert 3.0 <= late < 4.0 + (kind == PWM), late
        assert np.abs(found[edge - 500:edge + 140, 2]).max() < on


@pytest.mark.parametrize("pairs", [1, 4])
def test_late_angles_of_foc_turn_its_currents_by_as_much(pairs):
    """Its axes are those of the angle that it knows: i = i_set sin(p (θ - ω τ) - φ_k)."""
    a = changed(motor={**HEAVY, "pole_pairs": pairs}, drive={"kind": FOC},
                control={"position_gain": 0.0, "integral_gain": 0.0},
                acquisition={"commutation_latency": 2.0})
    found = run(a, state_of(a, omega_m=150.0), 0.2, inverter_on=0.01, rate=100_000.0).out
    part = found[8_000:8_000 + round(2.0 * math.pi / 150.0 * 1e5)]
    lags = [np.angle(np.vdot(np.exp(1j * part[:, 8]), part[:, k])) for k in (5, 2)]
    lag = (lags[0] - lags[1]) % (2.0 * math.pi)
    assert min(lag, 2.0 * math.pi - lag) == pytest.approx(
        pairs * 150.0 * 2.0 * a.control.period, rel=0.03)


def test_the_longest_delay_is_kept():
    """2 ms of the effect in the shortest control periods and the longest latency: 300."""
    a = changed(motor={"static_friction": 1e9, "dynamic_friction": 1e9}, drive={"kind": FOC},
                control={"period": 1e-5}, inverter={"current_limit": 7.0},
                acquisition={"reference_latency": 100.0})
    assert st.N_HISTORY > 301
    found = run(a, state_of(a, angle=math.pi / 2), 0.02, inverter_on=0.01, command=0.4,
                effects=parse_effects(["control_delay.delay=2e-3"]), rate=100_000.0).out
    assert np.flatnonzero(found[:, 5])[0] == 1000 + 200
    assert np.flatnonzero(np.abs(found[:, 2]) > 1e-9)[0] == 1000 + 300


def test_a_converter_that_truncates_reads_half_a_step_too_little():
    """So does the control: the motor turns faster than it reads, by as much."""
    a, truncates = changed(), changed(converters={"speed_offset": -0.5})
    half = 0.5 * a.converters.speed_range / 2.0**a.converters.speed_bits
    profile, found = step_profile(0.3, start=-0.1, duration=0.2), []
    for one in (a, truncates):
        record = simulate(profile, actuator=one, noise=0.0, seed=1)
        slew = (record.time > 0.08) & (record.time < 0.18)
        turned = np.unwrap(record.channel("rotor_angle"))[slew]
        found.append(np.polyfit(record.time[slew], turned, 1)[0]
                     - record.channel("motor_speed")[slew].mean())
    assert found[1] - found[0] == pytest.approx(half, rel=0.05)


@pytest.mark.parametrize(("period", "rate"), [(100e-6, 16_000.0), (62.5e-6, 33_300.0)])
def test_a_block_without_a_control_period_draws_no_noise(period, rate):
    """So samples are the same in blocks of any length."""
    of = changed(control={"period": period}, acquisition={"rate": rate})
    runs = []
    for size in (10**6, 1, 7):
        session = ActuatorSession(of, seed=3, position=-0.1, settle=False)
        session.command(step_profile(0.1, start=-0.1, duration=0.05))
        blocks = []
        while session.active and len(block := session.advance(size)):
            blocks.append(block)
        runs.append(np.concatenate(blocks))
    for other in runs[1:]:
        np.testing.assert_array_equal(other, runs[0])
