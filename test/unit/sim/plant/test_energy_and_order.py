"""Energy balance over a whole test, and the measured order of the kernel."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from ema_record.actuator import Actuator
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.plant import state as st
from ema_sim.simulate import simulate_traced
from support.actuators import both_machines, changed
from support.plant import convergence, run, state_of


def balance(a: Actuator, rate: float, settings: list[str], profile: str) -> dict[str, float]:
    """Return where the energy of a test went (J)."""
    e = parse_effects(settings)
    x = simulate_traced(load_profile(profile), actuator=a, rate=rate, effects=e, seed=3).state
    r = a.motor.phase_inductance
    return {
        "terminal": x[st.E_TERMINAL],
        "copper": x[st.E_COPPER],
        "magnetic": 0.5 * r * float(np.sum(x[[st.I_A, st.I_B, st.I_C]] ** 2)),
        "motor": x[st.E_MOTOR],
        "kinetic": 0.5 * a.motor.inertia * x[st.OMEGA_M] ** 2
        + 0.5 * a.surface.inertia * x[st.OMEGA_S] ** 2,
        "friction, motor": x[st.E_FRICTION_M],
        "friction, surface": x[st.E_FRICTION_S],
        "shaft": x[st.E_SHAFT],
        "load": x[st.E_LOAD],
    }


CASES = [
    [],
    ["turn_short.fraction=0.3", "turn_short.mode=paper"],
    ["rotor_eccentricity.zeta=0.3", "rotor_eccentricity.mode=shifted"],
    ["back_emf_shape.sine_share=1"],
    ["surface_load.slope=200", "surface_load.constant=50"],
    ["gear_mesh_ripple.amplitude=1e-4"],
    ["motor_friction.increase=0.5", "stribeck_friction.increase=0.5",
     "viscous_friction.coefficient=2e-4", "load_dependent_friction.coefficient=0.2"],
    ["backlash.increase=5e-3"],
    ["bus_voltage_sag.resistance=0.5", "inverter_voltage_drop.drop=1"],
]


@both_machines
@pytest.mark.parametrize("profile", ["step", "extended"])
@pytest.mark.parametrize("settings", CASES, ids=lambda s: ",".join(s) or "neutral")
def test_energy_balance(settings, profile, machine):
    """Every joule at the terminals is found again, to 0.1 %, electrically and mechanically."""
    # The torque's saturation is a limit, not a loss: out of reach here.
    a = changed(machine.actuator, motor={"torque_limit": 10.0})
    j = balance(a, machine.rate, settings, profile)
    electrical = j["copper"] + j["magnetic"] + j["motor"]
    mechanical = (
        j["kinetic"] + j["friction, motor"] + j["friction, surface"] + j["shaft"] + j["load"]
    )
    assert j["terminal"] > 10.0
    assert electrical == pytest.approx(j["terminal"], rel=1e-3), j
    assert mechanical == pytest.approx(j["motor"], rel=1e-3), j
    for loss in ("copper", "friction, motor", "friction, surface", "shaft"):
        assert j[loss] > 0.0


def final_state(actuator: Actuator, electrical: bool, max_step: float) -> np.ndarray:
    """Return currents, speeds, angles after 2 ms with legs fixed or the inverter off."""
    smooth = {"static_friction": 0.0, "dynamic_friction": 0.0}
    a = changed(actuator, motor=smooth, surface=smooth, inverter={"hysteresis": 1e6},
                shaft={"backlash": 0.0, "damping": 5.0}, control={"period": 1e-3})
    ratio = a.gear.ratio
    start = state_of(a, angle=0.7, i_a=3.0, i_b=-1.0, i_c=-2.0, leg_b=-1.0, omega_m=300.0,
                     omega_s=0.4, theta_m=0.01 * ratio)
    # The kept derivatives of a smooth start, from a run of one tiny step.
    shaft = a.shaft.stiffness * 0.01 + a.shaft.damping * (300.0 / ratio - 0.4)
    k = a.motor.back_emf_constant
    torque = k * sum(
        i * np.sin(0.7 - p * 2 * np.pi / 3) for p, i in enumerate((3.0, -1.0, -2.0))
    )
    start[st.ALPHA_M] = (torque - shaft / ratio - 1e-4 * 300.0) / a.motor.inertia
    start[st.ALPHA_S] = (shaft - 2.0 * 0.4) / a.surface.inertia
    found = run(a, start, 2e-3, effects=parse_effects(["back_emf_shape.sine_share=1"]),
                rate=1000.0, inverter_on=0.0 if electrical else np.inf, max_step=max_step)
    chosen = [st.OMEGA_M, st.THETA_M, st.OMEGA_S, st.THETA_S]
    return found.state[[st.I_A, st.I_B, st.I_C, *chosen] if electrical else chosen]


@both_machines
@pytest.mark.parametrize("electrical", [True, False], ids=["legs fixed", "inverter off"])
def test_order_of_convergence_is_two(electrical, machine):
    order, error = convergence(partial(final_state, machine.actuator, electrical), 0.05e-6)
    assert 1.8 < order < 2.3, (order, error)
    assert error[0] < 1e-3
