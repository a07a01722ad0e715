"""Drives with a carrier against closed forms: currents, torques, ripples; averaged or switched."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ema_record.actuator import FOC, HARMONICS, PWM, PWM_INDEPENDENT, RELAY, Actuator
from ema_record.profile import step_profile
from ema_sim.effects import parse_effects
from ema_sim.plant import state as st
from ema_sim.session import ActuatorSession
from ema_sim.simulate import simulate_traced
from support.actuators import DEFAULT, OTHER, both_machines, changed
from support.plant import lines, run, state_of

pytestmark = pytest.mark.slow  # compiles seven kernels

LOCKED = {"static_friction": 1e9, "dynamic_friction": 1e9}
CURRENT = 7.0
SINE = {"back_emf": HARMONICS}
CARRIERS = {"pwm": PWM, "foc": FOC, "pwm_independent": PWM_INDEPENDENT}
of_carriers = pytest.mark.parametrize("kind", CARRIERS.values(), ids=CARRIERS)
both_ways = pytest.mark.parametrize("switching", [False, True], ids=["averaged", "switched"])


def drive_of(actuator: Actuator, kind: int, **parts: dict[str, float]) -> Actuator:
    """Return an actuator whose current control settles in a few periods of the carrier."""
    gain = 0.3 * actuator.motor.phase_inductance * actuator.drive.pwm_frequency
    tuned = {"kind": kind, "proportional_gain": gain, "integral_gain": 300.0 * gain}
    return changed(actuator, **{**parts, "drive": {**tuned, **parts.get("drive", {})}})


def steady(a: Actuator, omega: float, duration: float, switching: bool, *settings: str):
    """Run at the current limit with a rotor so heavy that its speed stays `omega`."""
    a = changed(
        a, motor={"inertia": 10.0, "torque_limit": 1e3},
        inverter={"current_limit": CURRENT, "bus_voltage": 200.0}, shaft={"backlash": 0.1},
        control={"proportional_gain": 1e3, "speed_limit": 1e4, "integral_gain": 0.0},
        converters={"speed_range": 1e5},
    )
    return a, run(a, state_of(a, omega_m=omega), duration, inverter_on=0.0, command=0.5,
                  effects=parse_effects(settings), switching=switching)


@both_ways
@of_carriers
def test_steady_current_of_resistance_under_a_proportional_control(kind, switching):
    """Rotor locked: i = K_p i_ref / (K_p + R) of each phase, the legs' mean voltage is u.

    To 0.1 %: the currents are read where the ripple crosses its mean, but for its curvature,
    (T R / L)²/24 of it.
    """
    a = changed(
        motor=LOCKED, inverter={"current_limit": CURRENT},
        drive={"kind": kind, "proportional_gain": 2.5, "integral_gain": 0.0})
    found = run(a, state_of(a, angle=1.2), 0.02, inverter_on=0.0, command=0.4,
                switching=switching)
    last = found.out[-40:].mean(axis=0)
    expected = 2.5 / (2.5 + a.motor.phase_resistance) * last[5:8]
    assert np.abs(last[5:8]).max() > 0.9 * CURRENT
    assert last[2:5] == pytest.approx(expected, rel=1e-3, abs=1e-3 * CURRENT)


@both_ways
def test_the_integral_brings_the_current_to_its_reference(switching):
    a = drive_of(DEFAULT.actuator, PWM, motor=LOCKED, inverter={"current_limit": CURRENT})
    found = run(a, state_of(a, angle=1.2), 0.03, inverter_on=0.0, command=0.4,
                switching=switching)
    last = found.out[-40:].mean(axis=0)
    assert last[2:5] == pytest.approx([CURRENT, -CURRENT, 0.0], abs=1e-3 * CURRENT)


@both_ways
@both_machines
@pytest.mark.parametrize("omega", [200.0, -200.0])
def test_torque_of_sinusoidal_currents_on_a_sinusoidal_back_emf(machine, omega, switching):
    """Sinusoidal currents on a sinusoidal back-EMF make a steady torque.

    T = 3/2 k I at any angle: i_d is 0 and i_q the amplitude. To 0.5 %: over a period of the
    carrier the rotor turns on under voltages that stand (ω_e T = 4 % of a radian).
    """
    a, found = steady(
        drive_of(machine.actuator, FOC, motor=SINE), omega, 0.08, switching)
    torque = found.trace[-1000:, 0]
    assert torque.mean() == pytest.approx(1.5 * a.motor.back_emf_constant * CURRENT, rel=5e-3)
    assert torque.std() < 2e-3 * torque.mean()
    theta, currents = found.out[-1000:, 8], found.out[-1000:, 2:5]
    for phase in range(3):
        shape = np.sin(theta - phase * 2.0 * math.pi / 3.0)
        # Means over a sample: the reference is that of the angle in its middle.
        assert found.out[-1000:, 5 + phase] == pytest.approx(CURRENT * shape, abs=0.01 * CURRENT)
        assert currents[:, phase] == pytest.approx(CURRENT * shape, abs=0.03 * CURRENT)


@both_ways
@both_machines
def test_torque_of_six_steps_on_a_trapezoid(machine, switching):
    """T = 2 k I between commutations, where two phases conduct under their flat tops.

    At 5 rad/s a sector is 13 time constants of the integral or more: the median has settled.
    """
    a, found = steady(drive_of(machine.actuator, PWM), 5.0, 0.6, switching)
    torque = found.trace[4000:, 0]
    assert np.median(torque) == pytest.approx(2.0 * a.motor.back_emf_constant * CURRENT, rel=5e-3)


@both_ways
@pytest.mark.parametrize(
    ("third", "fifth", "seventh"),
    [(0.2, 0.0, 0.0), (0.0, -0.06, 0.0), (0.0, 0.0, 0.05), (0.1, 0.06, -0.03)])
def test_harmonics_make_a_torque_ripple_of_6_fe(third, fifth, seventh, switching):
    """Harmonics of the back-EMF make a ripple at six times the electrical angle.

    Σ sin θ_k (sin θ_k + h5 sin 5θ_k + h7 sin 7θ_k) = 3/2 (1 + (h7 - h5) cos 6θ); the third
    makes none. To 4 % and 0.3 % of the torque: the harmonics of the back-EMF k ω h move the
    current by k ω / K_p I, 2.5 % of h at 20 rad/s.
    """
    a, found = steady(
        drive_of(DEFAULT.actuator, FOC, motor={
            **SINE, "harmonic_3": third, "harmonic_5": fifth, "harmonic_7": seventh}),
        20.0, 0.36, switching)
    kI = 1.5 * a.motor.back_emf_constant * CURRENT
    amplitude = lines(found.trace[400:, 0], found.out[400:, 8], highest=12)
    assert amplitude[0] == pytest.approx(kI, rel=5e-3)
    assert amplitude[6] == pytest.approx(kI * abs(seventh - fifth), rel=0.04, abs=2e-3 * kI)
    assert max(np.delete(amplitude, [0, 6])) < 3e-3 * kI


@pytest.mark.parametrize(("settings", "factors"), [
    (["turn_short.fraction=0.2", "turn_short.phase=b", "turn_short.mode=paper"], (1.0, 0.8, 1.0)),
    (["winding_temperature.temperature=120"], (0.89, 0.89, 0.89)),
    (["torque_constant_drop.drop=0.1"], (0.9, 0.9, 0.9)),
    (["rotor_eccentricity.zeta=0.2", "rotor_eccentricity.mode=static"], (1.2, 0.9, 0.9)),
    (["back_emf_shape.sine_share=1"], (1.0, 1.0, 1.0)),
])
def test_effects_of_the_winding_act_on_harmonics_too(settings, factors):
    """T = I Σ k_k sin² θ_k over a turn: half of each phase's k. To 1 %, as above."""
    a, found = steady(
        drive_of(DEFAULT.actuator, FOC, motor={**SINE, "harmonic_5": 0.05}), 200.0, 0.2, False,
        *settings)
    expected = 0.5 * sum(factors) * a.motor.back_emf_constant * CURRENT
    assert found.trace[400:, 0].mean() == pytest.approx(expected, rel=0.01)


def test_a_sensor_turned_by_an_angle_costs_its_cosine():
    """i_q of the control is along θ + α: T = 3/2 k I cos α, references with the angle."""
    a, found = steady(drive_of(DEFAULT.actuator, FOC, motor=SINE), 200.0, 0.08, False,
                      "hall_misalignment.angle=0.4")
    assert found.trace[-1000:, 0].mean() == pytest.approx(
        1.5 * a.motor.back_emf_constant * CURRENT * math.cos(0.4), rel=0.01)
    assert found.out[-1000:, 5] == pytest.approx(
        CURRENT * np.sin(found.out[-1000:, 8]), abs=0.01 * CURRENT)


@of_carriers
def test_a_voltage_that_cannot_be_had_does_not_wind_up(kind):
    """Against a back-EMF above the bus the currents fall back; released, they settle at once.

    Without anti-windup 20 ms of 5 A missing charge the integral to three times the bus, which
    takes longer than 20 ms to discharge; with it what is missing goes with K_i / (K_p + R),
    in 4 ms by e: 2.5 % after 15 ms.
    """
    a = drive_of(DEFAULT.actuator, kind, motor={**LOCKED, "torque_limit": 1e3},
                 inverter={"current_limit": CURRENT}, shaft={"backlash": 0.1})
    starved = changed(a, inverter={"bus_voltage": 2.0})
    start = run(starved, state_of(a, angle=1.2), 0.02, inverter_on=0.0, command=0.4)
    assert np.abs(start.out[-1, 2:5]).max() < 0.3 * CURRENT
    after = run(a, start.state, 0.015, inverter_on=0.0, command=0.4)
    assert after.out[-1, 2:5] == pytest.approx(after.out[-1, 5:8], abs=0.05 * CURRENT)


def test_offsets_of_the_sensors_do_not_run_away_in_the_zero_sequence():
    """Three integrals and two currents: the sum of the errors is that of the offsets, always."""
    a = drive_of(DEFAULT.actuator, PWM, motor=LOCKED, inverter={"current_limit": CURRENT})
    offsets = parse_effects([f"current_sensor_offset.phase_{p}=0.5" for p in "abc"])
    found = run(a, state_of(a, angle=1.2), 0.2, inverter_on=0.0, command=0.4, effects=offsets)
    assert abs(found.state[[st.U_A, st.U_B, st.U_C]].sum()) < 1e-9
    assert found.out[-1, 2:5] - 0.5 == pytest.approx([CURRENT, -CURRENT, 0.0], abs=1e-3)


def test_controls_that_know_their_phase_alone_run_away_together():
    """Offsets move all three integrals by K_i times their mean until a leg stays at its rail.

    The currents do not feel it before: they are those of the line voltages.
    """
    offset, integral = 0.5, 300.0
    a = drive_of(DEFAULT.actuator, PWM_INDEPENDENT, motor=LOCKED,
                 inverter={"current_limit": CURRENT}, drive={"integral_gain": integral})
    offsets = parse_effects([f"current_sensor_offset.phase_{p}={offset}" for p in "abc"])
    rail = a.inverter.bus_voltage
    for duration, free in ((0.2, True), (1.0, False)):
        found = run(a, state_of(a, angle=1.2), duration, inverter_on=0.0, command=0.4,
                    effects=offsets)
        moved = -found.state[[st.U_A, st.U_B, st.U_C]].mean()
        if free:
            assert moved == pytest.approx(integral * offset * duration, rel=0.01)
            assert found.out[-1, 2:5] - offset == pytest.approx(
                [CURRENT, -CURRENT, 0.0], abs=1e-3)
        else:
            assert moved < 1.1 * rail < integral * offset * duration


@pytest.mark.parametrize("machine", [DEFAULT, OTHER], ids=["default", "other"])
@pytest.mark.parametrize(("kind", "shape"), [
    (PWM, {}), (PWM_INDEPENDENT, {}), (FOC, {}), (FOC, SINE)],
    ids=["pwm", "pwm_independent", "foc trapezoid", "foc sine"])
def test_averaged_and_switched_agree(kind, shape, machine):
    """Averaged and switched voltages give the same motion.

    Waveform by waveform, a step of the surface: means over samples as long as the carrier's
    period. To 2 % of the current's rms and 0.1 % of the speed's: what an edge's place in its
    period does is of second order in the ripple. That is so where edges fall alike; see below.
    """
    a = drive_of(machine.actuator, kind, motor=shape)
    mean, switched = (
        simulate_traced(step_profile(0.12, start=-0.1, duration=0.1), actuator=a, noise=0.0,
                        seed=2, rate=machine.rate, switching=switching, start_angle=2.62)
        for switching in (False, True))
    for name, share in (("motor_speed", 1e-3), ("phase_current_a", 0.02),
                        ("phase_current_b", 0.02), ("reference_current_c", 0.02)):
        one, other = mean.record.channel(name), switched.record.channel(name)
        assert np.sqrt(np.mean((one - other) ** 2)) < share * np.sqrt(np.mean(other**2)), name
    power = [x.record.dc_bus[-1, 2] for x in (mean, switched)]
    assert power[0] == pytest.approx(power[1], rel=0.02)


@pytest.mark.parametrize("angle", np.linspace(0.02, 6.0, 8).round(2))
def test_averaged_and_switched_move_alike_from_any_start_angle(angle):
    """Blocks, four pole pairs: an edge inside a period of the carrier acts in it or in the next.

    Phase currents part after some commutations (of 60 angles by up to 16 % of the rms, median
    1.4 %), the speed by up to 0.28 %.
    """
    a = drive_of(OTHER.actuator, PWM, motor={})
    mean, switched = (
        simulate_traced(step_profile(0.12, start=-0.1, duration=0.1), actuator=a, noise=0.0,
                        seed=2, rate=OTHER.rate, switching=switching, start_angle=angle).record
        for switching in (False, True))
    one, other = mean.channel("motor_speed"), switched.channel("motor_speed")
    assert np.sqrt(np.mean((one - other) ** 2)) < 4e-3 * np.sqrt(np.mean(other**2))
    assert mean.dc_bus[-1, 2] == pytest.approx(switched.dc_bus[-1, 2], rel=0.02)


@both_ways
@pytest.mark.parametrize("kind", [RELAY, *CARRIERS.values()], ids=["relay", *CARRIERS])
def test_blocks_of_any_size_give_the_same_bytes(kind, switching):
    """All that a step keeps for the next is in the state."""
    a = changed(drive={"kind": kind}, motor={"back_emf": HARMONICS, "harmonic_5": 0.05})
    effects = parse_effects(["magnetic_saturation.inverse_current=0.02", "turn_short.fraction=0.1",
                             "rotor_eccentricity.zeta=0.1", "control_delay.delay=7e-5"])
    profile = step_profile(0.05, start=-0.02, duration=0.06)
    found = []
    for block in (10_000, 7):
        session = ActuatorSession(
            a, effects, seed=3, position=-0.02, settle=False, switching=switching)
        session.command(profile)
        blocks = []
        while session.active:
            blocks.append(session.advance(block))
        found.append(np.concatenate(blocks))
    assert found[0].tobytes() == found[1].tobytes()
