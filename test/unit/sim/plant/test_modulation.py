"""Laws of the drives with a carrier: legs, rotor's axes, stability of the current control."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ema_record.actuator import CIRCLE, FOC, HEXAGON, INSTANT, MEAN, PWM, RELAY, SINE
from ema_record.errors import UsageError
from ema_record.profile import step_profile
from ema_sim.drives import check_drive, most_gain, shows_carrier
from ema_sim.plant.electrical import harmonics, of_phases
from ema_sim.plant.modulation import (
    independent_control,
    leg_now,
    modulated,
    phase_control,
    rotor_currents,
)
from ema_sim.simulate import simulate
from support.actuators import changed

THIRDS = np.arange(3) * 2.0 * math.pi / 3.0


def test_of_phases_is_the_sine_a_third_later_each():
    for theta in np.linspace(0.0, 2.0 * math.pi, 17):
        assert of_phases(math.sin(theta), math.cos(theta)) == pytest.approx(
            np.sin(theta - THIRDS), abs=1e-15)


def test_harmonics_are_those_of_the_angle():
    """The polynomials in sin θ are sin 3θ, sin 5θ, sin 7θ."""
    for theta in np.linspace(-7.0, 7.0, 41):
        expected = (math.sin(theta) + 0.3 * math.sin(3 * theta) - 0.2 * math.sin(5 * theta)
                    + 0.1 * math.sin(7 * theta))
        assert harmonics(math.sin(theta), 0.3, -0.2, 0.1) == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize(("d", "q"), [(0.0, 7.0), (3.0, 0.0), (-2.0, 5.0)])
def test_rotor_currents_turn_back_what_q_and_d_are(d, q):
    """i_k = i_q sin(θ - φ_k) + i_d cos(θ - φ_k), so that q alone makes torque on a sine."""
    for theta in np.linspace(0.0, 6.0, 13):
        i = q * np.sin(theta - THIRDS) + d * np.cos(theta - THIRDS)
        assert rotor_currents(math.sin(theta), math.cos(theta), *i) == pytest.approx((d, q))


@pytest.mark.parametrize("volts", [(30.0, -30.0, 0.0), (40.0, -8.0, -32.0), (48.0, -48.0, 0.0)])
def test_legs_make_the_line_voltages_that_are_asked_for(volts):
    rail = 48.0
    a, b, c, limited = modulated(*volts, rail, HEXAGON)
    assert not limited
    assert (rail * (a - b), rail * (b - c)) == pytest.approx(
        (volts[0] - volts[1], volts[1] - volts[2]))
    assert max(a, b, c) == pytest.approx(-min(a, b, c)) and max(a, b, c) <= 1.0


def test_a_voltage_beyond_the_bus_keeps_its_direction():
    """And a sine has the bus over the root of 3, 15 % more than without centring."""
    a, b, c, limited = modulated(90.0, -60.0, -30.0, 48.0, HEXAGON)
    assert limited and (a - b) / (b - c) == pytest.approx(150.0 / -30.0)
    assert max(a, b, c) == 1.0 and min(a, b, c) == -1.0
    for theta in np.linspace(0.0, 6.0, 30):
        for amplitude, beyond in ((1.154 * 48.0, False), (1.18 * 48.0, None)):
            found = modulated(*(amplitude * np.sin(theta - THIRDS)), 48.0, HEXAGON)[3]
            assert beyond is None or bool(found) is beyond


@pytest.mark.parametrize(("modulation", "radius"), [(CIRCLE, 2.0 / math.sqrt(3.0)), (SINE, 1.0)])
def test_a_circle_limits_every_direction_alike(modulation, radius):
    """That of centred legs touches the hexagon in the middle of its sides."""
    for theta in np.linspace(0.0, 6.0, 30):
        wave = np.sin(theta - THIRDS)
        inside = modulated(*(0.999 * radius * 48.0 * wave), 48.0, modulation)
        beyond = modulated(*(3.0 * radius * 48.0 * wave), 48.0, modulation)
        assert inside[3] is False and beyond[3] is True
        assert np.diff(inside[:3]) == pytest.approx(np.diff(0.999 * radius * wave), abs=1e-12)
        assert np.diff(beyond[:3]) == pytest.approx(np.diff(radius * wave), abs=1e-12)
        assert max(map(abs, beyond[:3])) <= 1.0 + 1e-12
        if modulation == SINE:
            assert beyond[:3] == pytest.approx(wave)


def test_controls_of_the_phases_differ_in_the_middle_of_the_voltages_alone():
    """As long as no leg is limited and the errors have no mean: the line voltages are the same."""
    d, errors = changed(drive={"kind": PWM}).drive, (3.0, -2.0, -1.0)
    one = phase_control(d, 48.0, *errors, 5.0, -5.0, 0.0)
    other = independent_control(d, 48.0, *errors, 5.0, -5.0, 0.0)
    assert np.diff(one[:3]) == pytest.approx(np.diff(other[:3])) and one[3:] == other[3:]
    assert max(one[:3]) == pytest.approx(-min(one[:3]))
    assert max(other[:3]) != pytest.approx(-min(other[:3]))


@pytest.mark.parametrize(("error", "kept"), [(30.0, True), (-1.0, False)])
def test_an_independent_leg_is_limited_alone_and_does_not_wind_up(error, kept):
    d = changed(drive={"kind": PWM}).drive
    step = d.integral_gain / d.pwm_frequency
    found = independent_control(d, 48.0, error, 1.0, -1.0, 60.0, 0.0, 0.0)
    assert found[0] == 1.0
    assert found[3] == (60.0 if kept else pytest.approx(60.0 + step * error))
    assert found[1:3] == pytest.approx(
        np.array([1.0, -1.0]) * (d.proportional_gain + step) / 48.0)


@pytest.mark.parametrize("mean", [-1.0, -0.4, 0.0, 0.7, 1.0])
def test_a_leg_is_on_in_the_middle_of_the_period(mean):
    begin, period = 3e-3, 50e-6
    now, edges, on = begin, [], 0.0
    while now < begin + period - 1e-12:
        state, ahead = leg_now(mean, begin, period, now)
        ahead = min(ahead, begin + period - now)
        on += ahead if state > 0.0 else 0.0
        now += ahead
        edges.append(now - begin)
    assert on / period == pytest.approx(0.5 * (1.0 + mean), abs=1e-6)
    if abs(mean) < 1.0:
        assert edges[0] + edges[1] == pytest.approx(period), "not in the middle"


@pytest.mark.parametrize("integral", [0.0, 3000.0])
@pytest.mark.parametrize(("share", "stable"), [(0.98, True), (1.02, False)])
def test_the_bound_of_the_gains_is_where_the_control_gets_unstable(integral, share, stable):
    """Against the sampled loop itself, iterated."""
    a = changed(drive={"kind": PWM, "integral_gain": integral})
    period, r = 1.0 / a.drive.pwm_frequency, a.motor.phase_resistance
    gain = share * most_gain(a) - 0.5 * integral * period
    kept, i, x = math.exp(-r * period / a.motor.phase_inductance), 1.0, 0.0
    for _ in range(5000):
        x -= integral * period * i
        i = kept * i + (1.0 - kept) / r * (x - gain * i)
    assert (abs(i) < 1e-3) == stable
    a = changed(a, drive={"proportional_gain": gain})
    if stable:
        check_drive(a)
    else:
        with pytest.raises(UsageError, match="not stable at pwm_frequency 20000 /s"):
            check_drive(a)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "sampling", "time_at", "rate", "shows"), [
    (PWM, MEAN, 1.0, 20e3, False), (FOC, MEAN, 0.5, 10e3, False), (FOC, MEAN, 1.0, 8e3, True),
    (PWM, MEAN, 1.0, 50e3, True), (PWM, INSTANT, 0.0, 20e3, False),
    (PWM, INSTANT, 0.5, 20e3, False), (PWM, INSTANT, 0.3, 20e3, True),
    (RELAY, MEAN, 1.0, 8e3, False)])
def test_samples_show_the_carrier_where_averages_differ_from_edges(
        kind, sampling, time_at, rate, shows):
    """Held against records of both, the rotor turning: at 20 kHz the carrier has its period."""
    a = changed(drive={"kind": kind}, acquisition={"sampling": sampling, "time_at": time_at})
    assert shows_carrier(a, rate) == shows
    if kind == RELAY:
        return
    mean, edges = (simulate(step_profile(0.1, start=-0.1, duration=0.1), actuator=a, noise=0.0,
                            seed=2, rate=rate, switching=switching).samples[:, 2]
                   for switching in (False, True))
    apart = np.median(np.abs(edges - mean)[len(mean) // 2:])  # 1 to 2 mA, or 6 to 120
    assert (apart > 4e-3) == shows, apart


@pytest.mark.parametrize(("drive", "message"), [
    ({"pwm_frequency": 1000.0}, r"pwm_frequency 1000 /s: .* at least 1510 /s"),
    ({"proportional_gain": 0.0}, r"proportional_gain 0 V/A: the current control needs one"),
    ({"proportional_gain": 40.0}, r"must be below 28\.8 V/A: lower them or raise"),
])
def test_a_drive_that_cannot_work_is_one_line(drive, message):
    for kind in (PWM, FOC):
        a = changed(drive={"kind": kind, **drive})
        with pytest.raises(UsageError, match=message) as caught:
            simulate(step_profile(0.01, start=0.0), actuator=a)
        assert "\n" not in str(caught.value)
    simulate(step_profile(0.01, start=0.0, duration=0.03), actuator=changed(drive=drive))
