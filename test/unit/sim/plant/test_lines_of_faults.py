"""Lines of the faults in speed and torque against closed forms, open loop.

Open loop: the speed error is so large that the reference current stays at its limit, the
motor is free of the surface, and a viscous torque lets it settle at a speed.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from ema_record.actuator import Actuator
from ema_sim.effects import parse_effects
from support.actuators import DEFAULT, both_machines, changed
from support.plant import lines, run, state_of

CURRENT = 7.0
OMEGA = 600.0


def open_loop(*settings: str, current: float = CURRENT, torque_limit: float = 1.6,
              actuator: Actuator = DEFAULT.actuator):
    """Return speed, torque and their lines (amplitudes by order) in the steady state."""
    torque = min(2.0 * actuator.motor.back_emf_constant * current, torque_limit)
    a = changed(
        actuator,
        inverter={"current_limit": current, "hysteresis": 0.1, "bus_voltage": 200.0},
        motor={"viscous_friction": torque / OMEGA, "dynamic_friction": 0.0,
               "static_friction": 0.0, "torque_limit": torque_limit},
        gear={"ratio": 1e5}, shaft={"backlash": 0.1},
        control={"proportional_gain": 1e3, "speed_limit": 1e4, "integral_gain": 0.0},
        converters={"speed_range": 1e5},
    )
    start = state_of(a, omega_m=OMEGA)
    found = run(a, start, 0.35, effects=parse_effects(settings), inverter_on=0.0, command=0.5)
    keep = found.out[:, 0] > 0.15
    theta, speed, torque = found.out[keep, 8], found.out[keep, 1], found.trace[keep, 0]
    assert speed.mean() == pytest.approx(OMEGA, rel=0.25)
    return a, speed.mean(), lines(speed, theta), lines(torque, theta), torque


@both_machines
@pytest.mark.parametrize("fraction", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("phase", "abc")
def test_two_fe_speed_line_of_a_turn_short(fraction, phase, machine):
    a, omega, speed, _, _ = open_loop(
        f"turn_short.fraction={fraction}", f"turn_short.phase={phase}", "turn_short.mode=paper",
        actuator=machine.actuator,
    )
    kI = a.motor.back_emf_constant * CURRENT
    expected = 0.551 * fraction * kI / (a.motor.inertia * 2.0 * a.motor.pole_pairs * omega)
    assert speed[2] == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("phase", "abc")
def test_weak_phase_of_a_unit_is_a_short_of_mode_paper(phase):
    weak = changed(motor={f"back_emf_deviation_{phase}": -0.1})
    short = changed()
    ends = [
        run(actuator, state_of(actuator), 0.05, effects=parse_effects(settings), command=0.4)
        for actuator, settings in ((weak, []), (short, [
            "turn_short.fraction=0.1", f"turn_short.phase={phase}", "turn_short.mode=paper"]))
    ]
    assert np.allclose(ends[0].out, ends[1].out, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("zeta", [0.05, 0.2, -0.2])
@pytest.mark.parametrize("phase", "abc")
def test_torque_lines_of_eccentricity_in_one_phase(zeta, phase):
    angle = {"a": 0.0, "b": 2 * math.pi / 3, "c": 4 * math.pi / 3}[phase]
    a, _, _, torque, _ = open_loop(
        f"rotor_eccentricity.zeta={zeta}", "rotor_eccentricity.mode=paper",
        f"rotor_eccentricity.phase={phase}", f"rotor_eccentricity.angle={angle}",
    )
    scale = abs(zeta) * a.motor.back_emf_constant * CURRENT
    assert torque[1] / scale == pytest.approx(0.391, rel=0.1)
    assert torque[3] / scale == pytest.approx(0.413, rel=0.1)


def test_torque_line_of_shifted_eccentricity():
    a, _, _, torque, _ = open_loop(
        "rotor_eccentricity.zeta=0.1", "rotor_eccentricity.mode=shifted"
    )
    scale = 0.1 * a.motor.back_emf_constant * CURRENT
    assert torque[3] / scale == pytest.approx(1.24, rel=0.1)


@pytest.mark.parametrize(
    ("settings", "orders"),
    [
        (["rotor_eccentricity.zeta=0.1", "rotor_eccentricity.mode=common"], [1]),
        (["rotor_eccentricity.zeta=0.1", "rotor_eccentricity.mode=static"], [2, 4]),
        (["rotor_eccentricity.zeta=0.1", "rotor_eccentricity.mode=paper"], [1, 3]),
        (["turn_short.fraction=0.1"], [2, 4]),
        (["cogging_torque.amplitude=0.02", "cogging_torque.periods=4"], [4]),
    ],
)
def test_lines_that_break_the_symmetry(settings, orders):
    """What does not survive "rotate 120 degrees and permute" gives lines beside 3 f_e."""
    _, _, _, torque, _ = open_loop(*settings)
    _, _, _, floor, _ = open_loop()
    for order in orders:
        assert torque[order] > 5.0 * floor[order] + 0.003


@pytest.mark.parametrize(
    "settings",
    [
        [],
        ["rotor_eccentricity.zeta=0.3", "rotor_eccentricity.mode=shifted"],
        ["back_emf_shape.fifth_harmonic=0.1"],
        ["back_emf_shape.flat_top_change=-0.6"],
        ["back_emf_shape.sine_share=1"],
        ["cogging_torque.amplitude=0.05", "cogging_torque.periods=3"],
        ["torque_constant_drop.drop=0.2"],
        ["hall_misalignment.angle=0.1"],
        ["magnetic_saturation.inverse_current=0.05"],
    ],
)
def test_symmetry_rule(settings):
    """What survives "rotate 120 degrees and permute the phases" gives only multiples of 3 f_e."""
    _, _, _, torque, mean = open_loop(*settings)
    broken = torque[[1, 2, 4, 5, 7, 8]]
    assert np.max(broken) < 0.004 * mean.mean()


def test_torque_saturates():
    """The torque never passes its limit, and stays there while k I asks for more."""
    a, _, _, _, torque = open_loop(current=7.0, torque_limit=0.4)
    assert 2.0 * a.motor.back_emf_constant * 7.0 > 0.5
    assert np.max(torque) <= 0.4 + 1e-9
    assert np.mean(torque == pytest.approx(0.4, abs=1e-9)) > 0.5
