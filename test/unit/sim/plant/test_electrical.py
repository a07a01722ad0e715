"""Electrical closed forms: commutation table, phase pair, the paper's equations 1 and 2."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ema_sim.effects import parse_effects
from ema_sim.machine import SECTOR_SIGNS
from ema_sim.plant import state as st
from ema_sim.plant.electrical import reference_signs, sector_ahead, trapezoid
from support.actuators import changed
from support.plant import run, state_of
from support.reference import sector_of

# The paper's Table 1: rotor angle (deg) and signs of the reference currents a, b, c.
TABLE_1 = [
    (0, 30, (0, -1, 1)), (30, 90, (1, -1, 0)), (90, 150, (1, 0, -1)), (150, 210, (0, 1, -1)),
    (210, 270, (-1, 1, 0)), (270, 330, (-1, 0, 1)), (330, 360, (0, -1, 1)),
]
LOCKED = {"static_friction": 1e9, "dynamic_friction": 1e9}


@pytest.mark.parametrize(("begin", "end", "signs"), TABLE_1)
def test_table_1(begin, end, signs):
    for degrees in np.linspace(begin + 0.01, end - 0.01, 7):
        theta = math.radians(degrees)
        assert reference_signs(sector_of(theta)) == signs
        assert tuple(SECTOR_SIGNS[sector_of(theta)]) == signs
        for direction in (1.0, -1.0):
            sector, gap = sector_ahead(theta, direction)
            assert reference_signs(sector) == signs
            edge = begin if direction < 0 else end
            if edge in (0, 360):  # sector 330 deg to 30 deg goes on across 0
                edge += direction * 30
            assert math.degrees(gap) == pytest.approx(abs(edge - degrees), abs=1e-4)


def test_table_1_follows_the_back_emf():
    """Two phases conduct, each where its trapezoid is flat and of the same sign."""
    for theta in np.linspace(0.001, 2 * math.pi - 0.001, 500):
        signs = reference_signs(sector_of(theta))
        for phase, sign in enumerate(signs):
            shape = trapezoid((theta - phase * 2 * math.pi / 3) % (2 * math.pi),
                              2 * math.pi / 3)
            if sign:
                assert shape == sign
            else:
                assert abs(shape) < 1.0


def test_step_of_one_phase_pair():
    """The pair a, b at standstill: i_a - i_b = 2V/R (1 - exp(-t R/L)), whatever c does."""
    a = changed(motor=LOCKED, inverter={"current_limit": 500.0})
    found = run(a, state_of(a, angle=math.pi / 3), 4e-3, inverter_on=0.0, command=0.4,
                max_step=2e-6)
    tau = a.motor.phase_inductance / a.motor.phase_resistance
    final = 2.0 * a.inverter.bus_voltage / a.motor.phase_resistance
    edges = np.arange(len(found.out) + 1) / 20_000.0
    integral = final * (edges + tau * np.exp(-edges / tau))
    expected = np.diff(integral) * 20_000.0
    assert np.max(np.abs(found.out[:, 2] - found.out[:, 3] - expected)) < 2e-5 * final
    assert np.max(np.abs(found.out[:, 4])) < a.inverter.hysteresis + 0.01
    assert np.max(np.abs(found.out[:, 2:5].sum(axis=1))) < 1e-9
    assert found.state[st.OMEGA_M] == 0.0


def test_phase_model_equals_the_papers_line_to_line_equations():
    """The paper's eqs. 1 and 2 with R_LL = 3R and L_LL = 3L, phases equal, legs fixed."""
    a = changed(motor={"inertia": 10.0}, inverter={"hysteresis": 1e6}, control={"period": 1e-3},
                shaft={"backlash": 0.1})
    e = parse_effects(["back_emf_shape.sine_share=1"])
    legs, omega, angle = (1.0, -1.0, 1.0), 400.0, 0.4
    start = state_of(a, angle=angle, i_a=3.0, i_b=-1.0, i_c=-2.0, leg_b=-1.0, omega_m=omega)
    found = run(a, start, 4e-3, effects=e, inverter_on=0.0, max_step=1e-6)

    m, v = a.motor, [a.inverter.bus_voltage * leg for leg in legs]
    r_ll, l_ll = 3.0 * m.phase_resistance, 3.0 * m.phase_inductance

    def derivative(t, loop):
        emf = [
            m.back_emf_constant * omega * math.sin(angle + omega * t - p * 2 * math.pi / 3)
            for p in range(3)
        ]
        delta = [  # eq. 1: between a and b, b and c, c and a
            (v[p] - v[(p + 1) % 3]) - (emf[p] - emf[(p + 1) % 3]) for p in range(3)
        ]
        return [(delta[p] - r_ll * loop[p]) / l_ll for p in range(3)]

    # Loop currents of sum 0 that give 3, -1, -2 A by eq. 2: I_1 - I_3, I_2 - I_1, I_3 - I_2.
    loops = solve_ivp(derivative, (0.0, 4e-3), [4 / 3, 1 / 3, -5 / 3], rtol=1e-10, atol=1e-10)
    i_1, i_2, i_3 = loops.y[:, -1]
    paper = [i_1 - i_3, i_2 - i_1, i_3 - i_2]
    assert found.state[st.OMEGA_M] == pytest.approx(omega, rel=1e-4)
    assert found.state[[st.I_A, st.I_B, st.I_C]] == pytest.approx(paper, rel=1e-3)
    assert found.state[[st.I_A, st.I_B, st.I_C]].sum() == pytest.approx(0.0, abs=1e-9)


def test_a_weak_source_and_its_capacitor():
    """Legs fixed, motor locked: windings, source and capacitor as one linear circuit."""
    a = changed(motor=LOCKED, inverter={"hysteresis": 1e6}, control={"period": 1e-3})
    resistance, capacitance, legs = 1.5, 0.8e-3, np.array([1.0, -1.0, 1.0])
    e = parse_effects([f"bus_voltage_sag.resistance={resistance}",
                       f"bus_voltage_sag.capacitance={capacitance}"])
    m, v = a.motor, a.inverter.bus_voltage

    def derivative(t, x):
        leg = (v - 0.5 * resistance * x[3]) * legs - m.phase_resistance * x[:3]
        drawn = 0.5 * legs @ x[:3]
        return [*(leg - leg.mean()) / m.phase_inductance,
                (drawn - x[3]) / (resistance * capacitance)]

    exact = solve_ivp(derivative, (0.0, 4e-3), np.zeros(4), rtol=1e-10, atol=1e-10).y[:, -1]
    for step, error in ((1e-6, 1e-3), (50e-6, 2e-2)):
        found = run(a, state_of(a, angle=0.4, leg_b=-1.0), 4e-3, effects=e, inverter_on=0.0,
                    max_step=step)
        assert found.state[[st.I_A, st.I_B, st.I_C, st.I_BUS]] == pytest.approx(exact, rel=error)
        stored = capacitance * resistance * found.state[st.I_BUS]  # less than when it began
        drawn = solve_ivp(lambda t, x: [*derivative(t, x), 0.5 * legs @ x[:3]], (0.0, 4e-3),
                          np.zeros(5), rtol=1e-10, atol=1e-10).y[4, -1]
        assert found.state[st.CHARGE] == pytest.approx(drawn - stored, rel=error)
