"""Several pole pairs: θ_e = p θ, e = k(θ_e) ω, T = Σ k(θ_e) i, f_e = p ω / 2π."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ema_prognostics.features.extract import extract
from ema_prognostics.features.signals import prepare
from ema_record.actuator import load_actuator
from ema_record.profile import load_profile
from ema_sim.campaign.reductions import summary
from ema_sim.machine import unit_trapezoid
from ema_sim.simulate import simulate, simulate_traced
from support.actuators import OTHER, changed
from support.plant import lines, run, state_of

P = OTHER.actuator.motor.pole_pairs
THIRDS = np.arange(3) * 2.0 * math.pi / 3.0


@pytest.fixture(scope="module")
def step():
    return simulate_traced(load_profile("step"), actuator=OTHER.actuator, seed=3, noise=0.0)


@pytest.mark.parametrize("omega", [300.0, -300.0])
def test_the_back_emf_drives_the_currents_at_p_times_the_speed(omega):
    """Legs fixed alike, a heavy rotor: the back-EMF alone drives R, L at p ω / 2π."""
    a = changed(OTHER.actuator, motor={"inertia": 10.0}, inverter={"hysteresis": 1e6},
                control={"period": 1e-3}, shaft={"backlash": 0.1})
    found = run(a, state_of(a, omega_m=omega), 0.06, inverter_on=0.0, max_step=2e-6)
    t, current = found.out[:, 0], found.out[:, 2]
    settled = t > 0.02
    angle = np.unwrap(found.out[:, 8])[settled]
    assert np.polyfit(t[settled], angle, 1)[0] == pytest.approx(P * omega, rel=1e-3)
    amplitude = lines(current[settled], P * omega * t[settled], highest=5)
    # First line of a trapezoid of 120 degrees, through the impedance at p ω.
    ramp = math.pi / 6.0
    emf = a.motor.back_emf_constant * abs(omega) * 4.0 / math.pi * math.sin(ramp) / ramp
    reactance = P * abs(omega) * a.motor.phase_inductance
    impedance = math.hypot(a.motor.phase_resistance, reactance)
    assert amplitude[1] == pytest.approx(emf / impedance, rel=5e-3)
    assert max(amplitude[2:5]) < 0.02 * amplitude[1]


def test_the_torque_is_the_sum_of_k_times_current(step):
    samples, motor = step.record.samples, OTHER.actuator.motor
    theta = samples[:, 8]
    shape = np.column_stack([unit_trapezoid(theta - x, motor.flat_top) for x in THIRDS])
    torque = motor.back_emf_constant * (shape * samples[:, 2:5]).sum(axis=1)
    slewing = (step.record.time > 0.1) & (step.record.time < 0.36)
    assert torque[slewing].mean() == pytest.approx(step.trace[slewing, 0].mean(), rel=0.01)
    assert np.std(torque[slewing] - step.trace[slewing, 0]) < 0.02 * torque[slewing].mean()


def test_the_electrical_frequency_is_p_times_that_of_the_motor(step):
    found = summary(step.record)
    expected = P * found["speed_mean"] / (2.0 * math.pi)
    assert found["electrical_frequency"] == pytest.approx(expected, rel=2e-3)


def test_the_motor_angle_goes_with_speed_and_surface(step):
    """The angle is the integral of the speed and, from rest to rest, N times the travel."""
    signals = prepare(step.record, OTHER.actuator)
    turned = signals.motor_angle[-1] - signals.motor_angle[0]
    assert turned == pytest.approx(np.trapezoid(signals.speed, signals.time), rel=1e-3)
    travelled = signals.position[-1] - signals.position[0]
    assert turned == pytest.approx(OTHER.actuator.gear.ratio * travelled, rel=5e-3)


@pytest.mark.parametrize("profile", ["step", "extended"])
def test_the_features_do_not_depend_on_the_pole_pairs(profile):
    """What relates motor, shaft and surface is the same; what is relative to nominal is near 0."""
    a = changed(load_actuator(), motor={"pole_pairs": P})
    found = extract(simulate(load_profile(profile), actuator=a, seed=3), profile, a)
    one = extract(simulate(load_profile(profile), seed=3), profile, load_actuator())
    same = ("lag_", "start_stiffness", "gap_width", "gap_torque", "shaft_slope", "torque_",
            "speed_over", "position_over", "inertia")
    for name in [n for n in found if n.startswith(same)]:
        assert found[name] == pytest.approx(one[name], abs=0.2), name
    for name in ("winding_back_emf", "winding_resistance", "winding_inductance"):
        assert abs(found[name]) < 0.05, name
    # A healthy torque balance: lines of a few parts in a thousand of the torque.
    assert max(abs(v) for n, v in found.items() if n.startswith("full_even_m")) < 20.0
