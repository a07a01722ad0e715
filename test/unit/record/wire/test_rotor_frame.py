"""Currents of the rotor's frame as channels, by the closed forms of Park's transformation."""

import numpy as np
import pytest

from ema_record.actuator import FOC, load_actuator
from ema_record.channels import (
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
)
from ema_record.errors import UsageError
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_record.wire.rotor_frame import RotorFrame, phase_currents, rotor_currents
from ema_sim.plant import modulation
from ema_sim.rebuild import completed
from support.actuators import changed
from support.simulations import record_of

ANGLES = np.linspace(-4.0, 9.0, 777)
FOC_ACTUATOR = changed(drive={"kind": FOC})


@pytest.mark.parametrize(("lead", "d", "q"), [
    (0.0, 0.0, 5.0), (np.pi / 2, 5.0, 0.0), (np.pi / 6, 2.5, 5.0 * np.sqrt(3.0) / 2.0)])
def test_balanced_currents_are_constants_of_the_rotor(lead, d, q):
    """5 A sin(θ + δ - φ_k) is i_q = 5 A cos δ, i_d = 5 A sin δ at any angle."""
    phases = 5.0 * np.sin(ANGLES[:, None] + lead - 2.0 * np.pi / 3.0 * np.arange(3))
    found_d, found_q = rotor_currents(phases, ANGLES)
    assert found_d == pytest.approx(np.full_like(ANGLES, d), abs=1e-12)
    assert found_q == pytest.approx(np.full_like(ANGLES, q), abs=1e-12)
    assert phase_currents(found_d, found_q, ANGLES) == pytest.approx(phases, abs=1e-12)


def test_sum_amplitude_and_power_are_kept():
    """Σ i = 0, Σ i² = 3/2 (i_d² + i_q²), Σ e_k i_k = 3/2 ê i_q with e_k = ê sin(θ - φ_k)."""
    rng = np.random.default_rng(1)
    d, q = rng.normal(size=(2, len(ANGLES)))
    phases = phase_currents(d, q, ANGLES)
    emf = 24.0 * np.sin(ANGLES[:, None] - 2.0 * np.pi / 3.0 * np.arange(3))
    assert phases.sum(axis=1) == pytest.approx(0.0 * ANGLES, abs=1e-12)
    assert (phases**2).sum(axis=1) == pytest.approx(1.5 * (d**2 + q**2))
    assert (emf * phases).sum(axis=1) == pytest.approx(1.5 * 24.0 * q)


def test_the_emulated_control_has_the_same_frame():
    phases = np.array([[1.0, -3.0, 2.0]])
    for angle in (0.0, 1.0, 4.0):
        d, q = rotor_currents(phases, np.array([angle]))
        assert modulation.rotor_currents(np.sin(angle), np.cos(angle), *phases[0]) == (
            pytest.approx((d[0], q[0])))


def test_angle_references_and_position_are_channels_where_they_are_measured():
    time, ones = np.arange(5) * 1e-3, np.ones(5)
    frame = RotorFrame(load_actuator())
    found = frame.samples(time, 3.0 * ones, 2.0 * ones, d=ones, angle=7.0 * ones,
                          reference_q=4.0 * ones, reference_d=-ones, position=0.1 * ones)
    assert np.isfinite(found).all()
    assert found[:, TIME] == pytest.approx(time)
    assert found[:, MOTOR_SPEED] == pytest.approx(3.0)
    assert found[:, ROTOR_ANGLE] == pytest.approx(7.0 - 2.0 * np.pi)
    assert found[:, SURFACE_POSITION] == pytest.approx(0.1)
    d, q = rotor_currents(found[:, REFERENCE_CURRENTS], 7.0 * ones)
    assert (d, q) == (pytest.approx(-ones), pytest.approx(4.0 * ones))
    assert np.isnan(RotorFrame(load_actuator()).samples(time, ones, ones)[:, 5:]).all()


def test_without_an_angle_it_is_the_integral_of_the_speed_over_all_blocks():
    """At a constant acceleration θ = p α t² / 2, which the trapezoidal rule gives exactly."""
    actuator = load_actuator()
    time = np.arange(1000) / actuator.acquisition.rate
    speed = 4000.0 * time
    frame = RotorFrame(actuator)
    parts = [frame.samples(time[a:b], speed[a:b], np.full(b - a, 5.0))
             for a, b in ((0, 1), (1, 400), (400, 400), (400, 1000))]
    angle = 0.5 * actuator.motor.pole_pairs * 4000.0 * time**2
    expected = phase_currents(np.zeros(1000), np.full(1000, 5.0), angle)
    assert np.concatenate(parts)[:, PHASE_CURRENTS] == pytest.approx(expected, abs=1e-9)


def test_i_q_alone_gives_back_torque_and_angle_up_to_its_start():
    """The rebuilt angle turns with the measured one: what differs is the unknown start."""
    record = record_of("extended", seed=3, actuator=FOC_ACTUATOR)
    s = record.samples
    q = rotor_currents(s[:, PHASE_CURRENTS], s[:, ROTOR_ANGLE])[1]
    made = RotorFrame(FOC_ACTUATOR).samples(
        s[:, TIME], s[:, MOTOR_SPEED], q, position=s[:, SURFACE_POSITION])
    whole = completed(Record(samples=made, profile=load_profile("extended")), FOC_ACTUATOR)
    turn = np.exp(1j * (whole[:, ROTOR_ANGLE] - s[:, ROTOR_ANGLE]))
    off = np.angle(turn / (turn.mean() / abs(turn.mean())))
    assert abs(off).max() < np.deg2rad(4.0)
    torque = rotor_currents(whole[:, PHASE_CURRENTS], whole[:, ROTOR_ANGLE])[1]
    moving = abs(s[:, MOTOR_SPEED]) > 20.0
    assert np.sqrt(np.mean((torque - q)[moving] ** 2)) < 0.02 * np.sqrt(np.mean(q[moving] ** 2))


def test_what_is_not_of_one_length_is_refused():
    with pytest.raises(UsageError, match=r"angle has shape \(4,\), time \(5,\): give a value"):
        RotorFrame(load_actuator()).samples(
            np.arange(5.0), np.ones(5), np.ones(5), angle=np.ones(4))
