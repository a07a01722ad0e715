"""Mechanical closed forms: friction, sticking, two-mass resonance, lost motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import least_squares

from ema_record.actuator import FOC
from ema_record.profile import Profile
from ema_sim.effects import parse_effects
from ema_sim.plant import state as st
from ema_sim.plant.kernel import MAX_STEP
from ema_sim.plant.mechanics import load_at, shaft_torque
from ema_sim.plant.prepared import masses_of
from ema_sim.simulate import simulate, simulate_traced
from support.actuators import both_machines, changed
from support.plant import run, state_of

FREE = {"backlash": 0.1}  # motor and surface do not touch
SMOOTH = {"static_friction": 0.0, "dynamic_friction": 0.0, "viscous_friction": 0.0}


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("viscous", [0.0, 1e-3])
def test_free_deceleration_of_the_motor(direction, viscous):
    """J dw/dt = -T - B w, and then it stands for good."""
    a = changed(shaft=FREE, motor={"viscous_friction": viscous})
    j, dry, w_0 = a.motor.inertia, a.motor.dynamic_friction, 100.0
    start = state_of(
        a, omega_m=direction * w_0, alpha_m=-direction * (dry + viscous * w_0) / j
    )
    found = run(a, start, 0.012, rate=100_000.0)
    t = found.out[:, 0]
    if viscous:
        tau = j / viscous
        stop = tau * math.log1p(viscous * w_0 / dry)
        speed = (w_0 + dry / viscous) * np.exp(-t / tau) - dry / viscous
        travel = tau * w_0 - dry / viscous * stop
    else:
        stop = j * w_0 / dry
        speed = w_0 - dry / j * t
        travel = 0.5 * w_0 * stop
    speed = np.where(t < stop, speed, 0.0)
    assert direction * found.out[:, 1] == pytest.approx(speed, abs=w_0 * 2e-3)
    assert np.all(found.out[t > stop + 3e-5, 1] == 0.0)
    assert direction * found.state[st.THETA_M] == pytest.approx(travel, rel=1e-4)
    assert found.state[st.THETA_S] == 0.0


def test_free_deceleration_of_the_surface():
    a = changed(shaft=FREE)
    s, w_0 = a.surface, 1.0
    torque = s.dynamic_friction + s.viscous_friction * w_0
    start = state_of(a, omega_s=w_0, alpha_s=-torque / s.inertia)
    found = run(a, start, 0.01, rate=100_000.0)
    tau = s.inertia / s.viscous_friction
    ratio = s.dynamic_friction / s.viscous_friction
    stop = tau * math.log1p(w_0 / ratio)
    assert found.state[st.OMEGA_S] == 0.0
    assert found.state[st.THETA_S] == pytest.approx(tau * w_0 - ratio * stop, rel=1e-4)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_surface_sticks_below_its_static_torque_and_slides_above(sign):
    a = changed(shaft=FREE)
    s = a.surface
    below = parse_effects([f"surface_load.constant={sign * 0.99 * s.static_friction}"])
    assert run(a, state_of(a), 0.02, effects=below).state[st.THETA_S] == 0.0
    above = parse_effects([f"surface_load.constant={sign * 1.01 * s.static_friction}"])
    found = run(a, state_of(a), 0.01, effects=above)
    tau = s.inertia / s.viscous_friction
    final = (1.01 * s.static_friction - s.dynamic_friction) / s.viscous_friction
    expected = final * (0.01 - tau * (1.0 - math.exp(-0.01 / tau)))
    assert -sign * found.state[st.THETA_S] == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("begin", [1.1, 1.23, 1.37])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_surface_turns_round_without_loss_of_time(sign, begin):
    """Under a load L: slower by (L + T) / J until it is at rest, then faster by (L - T) / J."""
    a = changed(shaft=FREE, surface={"viscous_friction": 0.0})
    s, load = a.surface, 4.0 * a.surface.static_friction
    down, up = (load + s.dynamic_friction) / s.inertia, (load - s.dynamic_friction) / s.inertia
    start = state_of(a, omega_s=sign * begin, alpha_s=-sign * down)
    effects = parse_effects([f"surface_load.constant={sign * load}"])
    found = run(a, start, 4e-3, effects=effects)
    rest = begin / down
    assert 1e-4 < rest < 3e-3
    assert -sign * found.state[st.OMEGA_S] == pytest.approx(up * (4e-3 - rest), rel=1e-6)
    travel = 0.5 * begin * rest - 0.5 * up * (4e-3 - rest) ** 2
    assert sign * found.state[st.THETA_S] == pytest.approx(travel, abs=begin * MAX_STEP)


def test_motor_turns_round_alike_at_any_step():
    """A slew back: what the motor has reached a millisecond after it was at rest."""
    a = changed(drive={"kind": FOC}, noise={"speed": 0.0, "current": 0.0, "position": 0.0})
    points = ((0.0, -0.2), (0.002, 0.2), (0.03, 0.2), (0.031, -0.2), (0.04, -0.2))
    profile = Profile(name="there-and-back", points=points)
    speeds = []
    for step in (MAX_STEP, 1e-6):
        samples = simulate_traced(profile, actuator=a, max_step=step).record.samples
        back = int(np.argmax((samples[:, 0] > 0.03) & (samples[:, 1] < 0.0)))
        assert back
        speeds.append(samples[back + 10:back + 30, 1].mean())
        at = samples[back, 0]
    assert speeds[0] == pytest.approx(speeds[1], abs=0.5), (speeds, at)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_motor_sticks_below_its_static_torque_and_starts_above(sign):
    a = changed(shaft=FREE)
    phase = ["cogging_torque.periods=1", f"cogging_torque.phase={sign * math.pi / 2}"]
    for share, moves in ((0.99, False), (1.01, True)):
        amplitude = share * a.motor.static_friction
        e = parse_effects([f"cogging_torque.amplitude={amplitude}", *phase])
        found = run(a, state_of(a, angle=0.0), 0.001, effects=e)
        assert (sign * found.state[st.THETA_M] > 0.0) == moves
        assert (found.state[st.OMEGA_M] != 0.0) == moves


@pytest.mark.parametrize("damping", [5.0, 30.0])
@both_machines
def test_two_mass_resonance(damping, machine):
    """Frequency sqrt(K / J) and damping of the twist, under a load that keeps contact."""
    a = changed(machine.actuator, motor=SMOOTH, surface=SMOOTH,
                shaft={"backlash": 0.0, "damping": damping})
    j_m, j_s = a.motor.inertia * a.gear.ratio**2, a.surface.inertia
    stiffness, reduced = a.shaft.stiffness, j_m * j_s / (j_m + j_s)
    load = 400.0
    rest = load * j_m / (j_m + j_s)
    start = state_of(a, theta_m=1.5 * rest / stiffness * a.gear.ratio)
    e = parse_effects([f"surface_load.constant={load}"])
    found = run(a, start, 0.06, effects=e)
    t, torque = found.out[:, 0], found.trace[:, 1]

    def misfit(p):
        omega, decay, cos, sin, mean = p
        swing = cos * np.cos(omega * t) + sin * np.sin(omega * t)
        return mean + np.exp(-decay * t) * swing - torque

    omega_0, decay = math.sqrt(stiffness / reduced), damping / (2.0 * reduced)
    fit = least_squares(misfit, [omega_0, decay, 0.5 * rest, 0.0, rest],
                        x_scale=[100.0, 10.0, rest, rest, rest])
    assert fit.x[0] == pytest.approx(math.sqrt(omega_0**2 - decay**2), rel=1e-3)
    assert fit.x[1] == pytest.approx(decay, rel=0.01)
    assert fit.x[4] == pytest.approx(rest, rel=1e-3)
    assert np.max(np.abs(fit.fun)) < 0.01 * rest


def lost_motion(increase: float) -> float:
    """Return how far the motor runs ahead of the surface more on the way up than down (rad)."""
    profile = Profile(name="reversal", points=((0.0, 0.0), (0.05, 0.0), (0.55, 0.04), (1.05, 0.0)))
    e = parse_effects([f"backlash.increase={increase}"])
    record = simulate(profile, effects=e, noise=0.0, start_angle=1.0)
    ahead = np.unwrap(record.channel("rotor_angle")) / 500.0 - record.channel("surface_position")
    up, down = (record.time > 0.3) & (record.time < 0.5), record.time > 0.85
    return float(ahead[up].mean() - ahead[down].mean())


def test_lost_motion_follows_the_backlash_with_slope_one():
    increase = np.array([0.0, 2e-4, 1e-3, 4e-3])
    measured = np.array([lost_motion(x) for x in increase])
    slope, offset = np.polyfit(increase, measured, 1)
    assert slope == pytest.approx(1.0, abs=0.01)
    # What is left: the nominal backlash and the twist under the surface's friction.
    assert 1e-4 < offset < 1e-4 + 2.0 * 90.0 / 1e5 + 1e-4


@pytest.mark.parametrize("share", [-0.95, 0.95])
def test_a_shaft_wound_by_less_than_friction_stays_wound_until_the_drive_moves_it(share):
    """The lag that a record shows begins at 0, so that it is less by the twist ever after."""
    profile = Profile(name="up", points=((0.0, 0.0), (0.05, 0.0), (0.55, 0.04)))
    a = changed()
    twist = share * (a.surface.static_friction / a.shaft.stiffness + 0.5 * a.shaft.backlash)
    lags = []
    for start in ((0.0, 0.0), (2e-4, twist)):
        record = simulate(profile, noise=0.0, start_angle=1.0, start=start)
        angle = np.unwrap(record.channel("rotor_angle"))
        still, late = record.time < profile.inverter_off, record.time > 0.3
        assert np.ptp(angle[still]) < 2e-4  # a step of its converter
        assert record.channel("surface_position")[still] == pytest.approx(start[0], abs=5e-5)
        ahead = (angle - angle[0]) / a.gear.ratio - record.channel("surface_position") + start[0]
        lags.append(float(ahead[late].mean()))
    assert lags[0] - lags[1] == pytest.approx(twist, abs=2e-5)


@pytest.mark.parametrize("damping", [0.0, 50.0])
def test_contact_in_the_lost_motion_only_pushes(damping):
    """However fast the sides part; within the lost motion there is none."""
    for twist in np.linspace(-2e-3, 2e-3, 41):
        for rate in (-100.0, -0.1, 0.0, 0.1, 100.0):
            torque = shaft_torque(twist, rate, 1e5, damping, 1e-3)
            assert torque * twist >= 0.0
            assert torque == 0.0 or abs(twist) > 5e-4
    assert shaft_torque(1e-3, 0.1, 1e5, damping, 1e-3) == pytest.approx(50.0 + 0.1 * damping)
    assert shaft_torque(-1e-3, -0.1, 1e5, damping, 1e-3) == pytest.approx(-50.0 - 0.1 * damping)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_gear_takes_its_share_of_the_power_whichever_way_it_flows(side):
    a = changed()
    a = a._replace(gear=a.gear._replace(efficiency=0.8))
    e = parse_effects([])
    twist = side * (1e-3 + 0.5 * a.shaft.backlash)
    for w_m, share in ((side, 1.25), (-side, 0.8)):  # the motor drives, or is driven
        load = load_at(a, e, masses_of(a, e), 0.0, 0.3, -twist, w_m, w_m / a.gear.ratio)
        assert load.shaft == pytest.approx(1e-3 * side * a.shaft.stiffness)
        assert load.motor * w_m == pytest.approx(share * load.shaft * w_m / a.gear.ratio)


def test_a_mesh_that_turns_the_surface_as_it_turns_itself_does_not_damp_it():
    """The rate of the twist is that of the gear's output, ripple and all."""
    a = changed()
    e = parse_effects(["gear_mesh_ripple.amplitude=1e-3", "gear_mesh_ripple.periods=12"])
    m, step, w_m, twist = masses_of(a, e), 1e-6, 300.0, 1e-3 + 0.5 * a.shaft.backlash
    for angle in (0.3, 1.1, 2.7):
        begin, still, end = (load_at(a, e, m, way, angle + way, -twist, 0.0, 0.0)
                             for way in (-step, 0.0, step))
        assert (end.shaft - begin.shaft) / (2.0 * step) == pytest.approx(
            still.slope * a.shaft.stiffness, rel=1e-5)
        assert abs(still.slope * a.gear.ratio - 1.0) > 0.1
        moved = load_at(a, e, m, 0.0, angle, -twist, w_m, w_m * still.slope)
        assert moved.shaft == pytest.approx(still.shaft, rel=1e-12)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_surface_that_meets_its_end_stop_stays_there(side):
    a = changed(shaft=FREE)
    stop = a.surface.end_stop
    start = state_of(a, theta_s=side * (stop - 1e-4), omega_s=side * 1.0,
                     theta_m=side * stop * a.gear.ratio)
    found = run(a, start, 1e-3)
    assert found.state[st.THETA_S] == side * stop
    assert found.state[st.OMEGA_S] == 0.0
