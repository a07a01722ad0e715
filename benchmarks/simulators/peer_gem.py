"""The common drive in gym-electric-motor with our relays around it; run by the peers' environment.

What differs: the relays are looked at once a step of the environment (its control cycle). Only
the physical system is stepped, without rewards, references and observations, which would add
to its time.
"""

from __future__ import annotations

import math

import gym_electric_motor as gem
import numpy as np
from gym_electric_motor.physical_systems.mechanical_loads import PolynomialStaticLoad
from gym_electric_motor.physical_systems.solvers import EulerSolver
from gym_electric_motor.physical_systems.voltage_supplies import IdealVoltageSupply

from benchmarks.simulators import drive as d
from benchmarks.simulators.python_loop import control, references

LIMITS = {"omega": 2000.0, "torque": 10.0, "i": 100.0, "epsilon": math.pi, "u": 2.0 * d.V_LEG}


def system(tau: float, theta: float) -> object:
    """Return the physical system at the regulated speed, rotor at `theta` (rad)."""
    environment = gem.make(
        "Finite-CC-PMSM-v0", tau=tau, supply=IdealVoltageSupply(u_nominal=2.0 * d.V_LEG),
        motor={
            "motor_parameter": {"p": 1, "r_s": d.R, "l_d": d.L, "l_q": d.L, "psi_p": d.K,
                                "j_rotor": d.J},
            "limit_values": LIMITS, "nominal_values": LIMITS,
            "motor_initializer": {"states": {
                "i_sq": 0.0, "i_sd": 0.0, "epsilon": (theta % (2.0 * math.pi)) - math.pi}},
        },
        load=PolynomialStaticLoad(
            load_parameter={"a": d.DRY, "b": d.VISCOUS, "c": 0.0, "j_load": 1e-12},
            load_initializer={"states": {"omega": d.OMEGA}},
        ),
        ode_solver=EulerSolver(),
    )
    environment.reset()
    return environment.unwrapped.physical_system


def simulate(theta: float, tau: float, length: float) -> np.ndarray:
    """Return samples, shape (n, 4): torque (N m), phase currents (A)."""
    physical = system(tau, theta)
    names = list(physical.state_names)
    place = [names.index(n) for n in ("omega", "torque", "i_a", "i_b", "i_c", "epsilon")]
    scale = np.array(physical.limits)[place]
    steps = round(d.SAMPLE / tau)
    omega, integral = d.OMEGA, 0.0
    legs, current, angle = [1, 1, 1], (0.0, 0.0, 0.0), theta
    out = np.empty((round(length / d.SAMPLE), 4))
    for row in out:
        i_ref, integral = control(omega, integral)
        total = np.zeros(4)
        for _ in range(steps):
            for j, ref in enumerate(references(angle, i_ref)):
                if current[j] >= ref + d.BAND:
                    legs[j] = 0
                elif current[j] <= ref - d.BAND:
                    legs[j] = 1
            state = physical.simulate(4 * legs[0] + 2 * legs[1] + legs[2])[place] * scale
            omega, angle = state[0], state[5] + math.pi  # its d axis leads our zero by π
            current = (state[2], state[3], state[4])
            total += state[1:5]
        row[:] = total / steps
    return out


def main() -> None:
    """Print the rows as JSON."""
    found = []
    for tau, angles in ((10e-6, d.ANGLES), (2e-6, d.ANGLES[:1])):
        found.append({
            "group": "relay", "name": "gym-electric-motor", "setting": f"step {tau * 1e6:g} µs",
            "reference": False,
            **d.measure(lambda theta, tau=tau: simulate(theta, tau, d.LENGTH), angles=angles),
        })
    d.report(found)


if __name__ == "__main__":
    main()
