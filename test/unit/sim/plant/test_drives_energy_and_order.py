"""Energy balance and order of convergence of the drives with a carrier, as of the relays."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from ema_record.actuator import FOC, HARMONICS, PWM, PWM_INDEPENDENT, Actuator
from ema_record.profile import step_profile
from ema_sim.plant import state as st
from ema_sim.simulate import simulate_traced
from support.actuators import both_machines, changed
from support.plant import convergence, run, state_of

pytestmark = pytest.mark.slow  # compiles six kernels

SHAPE = {"back_emf": HARMONICS, "harmonic_3": 0.1, "harmonic_5": 0.05, "harmonic_7": -0.03}
CASES = [(PWM, {}), (PWM, SHAPE), (PWM_INDEPENDENT, {}), (FOC, {}), (FOC, SHAPE)]
IDS = ["pwm trapezoid", "pwm harmonics", "pwm_independent", "foc trapezoid", "foc harmonics"]


@both_machines
@pytest.mark.parametrize("switching", [False, True], ids=["averaged", "switched"])
@pytest.mark.parametrize(("kind", "shape"), CASES, ids=IDS)
def test_energy_balance(kind, shape, switching, machine):
    """Every joule at the terminals is found again, to 0.1 %, electrically and mechanically."""
    a = changed(machine.actuator, motor={"torque_limit": 10.0, **shape}, drive={"kind": kind})
    x = simulate_traced(step_profile(0.3, start=-0.1, duration=0.25), actuator=a, seed=3,
                        rate=machine.rate, switching=switching).state
    magnetic = 0.5 * a.motor.phase_inductance * np.sum(x[[st.I_A, st.I_B, st.I_C]] ** 2)
    kinetic = 0.5 * a.motor.inertia * x[st.OMEGA_M] ** 2
    kinetic += 0.5 * a.surface.inertia * x[st.OMEGA_S] ** 2
    assert x[st.E_TERMINAL] > 5.0
    assert x[st.E_COPPER] + magnetic + x[st.E_MOTOR] == pytest.approx(x[st.E_TERMINAL], rel=1e-3)
    losses = x[[st.E_FRICTION_M, st.E_FRICTION_S, st.E_SHAFT, st.E_LOAD]]
    assert kinetic + losses.sum() == pytest.approx(x[st.E_MOTOR], rel=1e-3)


def final_state(actuator: Actuator, kind: int, switching: bool, max_step: float) -> np.ndarray:
    """Return currents, speeds and angles after 3 ms of control, without friction and backlash."""
    smooth = {"static_friction": 0.0, "dynamic_friction": 0.0}
    a = changed(
        actuator, motor={**smooth, **SHAPE}, surface=smooth,
        shaft={"backlash": 0.0, "damping": 0.0}, control={"period": 1e-3},
        converters={"speed_bits": 32, "position_bits": 32},
        # One period of the carrier is 50 of the longest steps.
        drive={"kind": kind, "pwm_frequency": 1000.0, "proportional_gain": 0.3,
               "integral_gain": 100.0},
    )
    # Without backlash and damping the shaft's torque has no jump where it changes sides.
    start = state_of(a, angle=0.7, i_a=3.0, i_b=-1.0, i_c=-2.0, omega_m=100.0, omega_s=0.2,
                     theta_m=0.003 * a.gear.ratio)
    found = run(a, start, 3e-3, rate=1000.0, inverter_on=0.0, command=0.1, max_step=max_step,
                switching=switching)
    chosen = [st.I_A, st.I_B, st.I_C, st.OMEGA_M, st.THETA_M, st.OMEGA_S, st.THETA_S]
    return found.state[chosen]


@both_machines
@pytest.mark.parametrize("switching", [False, True], ids=["averaged", "switched"])
@pytest.mark.parametrize("kind", [PWM, PWM_INDEPENDENT, FOC],
                         ids=["pwm", "pwm_independent", "foc"])
def test_order_of_convergence_is_two(kind, switching, machine):
    """With the control between; 1e-3 of the state at 20 µs."""
    order, error = convergence(partial(final_state, machine.actuator, kind, switching), 0.2e-6)
    assert 1.7 < order < 2.4, (order, error)
    assert error[0] < 1e-3
