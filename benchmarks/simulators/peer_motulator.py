"""The common drive in motulator and in its native export; run by the peers' environment.

What differs: carrier modulation and current-vector control (its own), so no relays; the
reference is its own native run at a tolerance of 1e-12.
"""

from __future__ import annotations

import math
import sys

import numpy as np
from motulator.common.model import SolverCfg
from motulator.drive import model
from motulator.drive.control import sm

from benchmarks.simulators import drive as d

SPEED_BANDWIDTH, CURRENT_BANDWIDTH = 2.0 * math.pi * 40.0, 2.0 * math.pi * 1000.0
LENGTH = 0.2
"""Its speed control begins without torque and takes 0.1 s to settle (s)."""
ANGLES = d.ANGLES[:2]
CLARKE = np.exp(1j * 2.0 * math.pi / 3.0 * np.arange(3))


def build(theta: float) -> tuple:
    """Return model and control at the regulated speed, rotor at `theta` (rad)."""
    par = sm.SynchronousMachinePars(n_p=1, R_s=d.R, L_d=d.L, L_q=d.L, psi_f=d.K)
    mechanics = model.MechanicalSystem(J=d.J, B_L=d.VISCOUS)
    mechanics.set_external_load_torque(d.DRY)
    mechanics.state.w_M = complex(d.OMEGA)
    mechanics.state.theta_M = complex(theta)
    machine = model.SynchronousMachine(par)
    machine.state.theta_m = complex(theta)
    drive = model.Drive(
        machine, mechanics,
        model.VoltageSourceConverter(u_dc=2.0 * d.V_LEG), pwm=True,
    )
    cfg = sm.CurrentVectorControllerCfg(
        i_s_max=d.I_MAX, alpha_c=CURRENT_BANDWIDTH, sensorless=False, T_s=d.PERIOD
    )
    control = sm.VectorControlSystem(
        sm.CurrentVectorController(par, cfg), sm.SpeedController(d.J, SPEED_BANDWIDTH)
    )
    control.set_speed_ref(d.OMEGA)
    return drive, control


def samples(result: object) -> np.ndarray:
    """Return torque and phase currents as means over samples."""
    found = result.mdl
    current = np.asarray(found.machine.i_s_ab)
    phases = np.real(current[:, None] * CLARKE.conj()[None, :])
    time, first = np.unique(np.asarray(found.t), return_index=True)
    return d.on_grid(time, np.column_stack([found.machine.tau_M, phases])[first], LENGTH)


def main() -> None:
    """Print the rows as JSON; motulator itself is run at its default tolerance only."""
    name = sys.argv[1]
    settings = [("rtol 1e-3 (default)", 1e-3)]
    if name == "motulator":
        simulation: type = model.Simulation
    else:
        from motulator_export import native

        simulation = native.Simulation
        settings.append(("rtol 1e-12", 1e-12))
    rows = []
    for label, tolerance in settings:
        cfg = SolverCfg(rtol=tolerance, atol=tolerance * 1e-3)

        def run(theta: float, cfg: SolverCfg = cfg) -> np.ndarray:
            drive, control = build(theta)
            made = simulation(drive, control, show_progress=False, cfg=cfg)
            return samples(made.simulate(t_stop=LENGTH))

        rows.append({
            "group": "carrier", "name": name, "setting": label, "reference": tolerance == 1e-12,
            **d.measure(run, LENGTH, ANGLES),
        })
    d.report(rows)


if __name__ == "__main__":
    main()
