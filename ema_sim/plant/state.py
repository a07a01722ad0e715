"""State of the actuator between two calls of the kernel: one float array, indices by name."""

from __future__ import annotations

import numpy as np

from ema_record.actuator import Actuator

(
    TIME, I_A, I_B, I_C, OMEGA_M, THETA_M, OMEGA_S, THETA_S, THETA_E, LEG_A, LEG_B, LEG_C,
    ALPHA_M, ALPHA_S, I_SET, INTEGRAL, SPEED_NOISE, POSITION_NOISE, TICK, SAMPLE, THETA_0,
    STEPS, CHARGE, E_TERMINAL, E_COPPER, E_MOTOR, E_FRICTION_M, E_FRICTION_S, E_SHAFT, E_LOAD,
    HISTORY,
) = range(31)  # fmt: skip

N_HISTORY = 256
"""Reference currents kept for `control_delay`, one a control period."""
N_STATE = HISTORY + N_HISTORY


def initial_state(actuator: Actuator, position: float, start_angle: float) -> np.ndarray:
    """Return the state at rest, no current, shaft relaxed.

    Parameters
    ----------
    actuator : parameters.
    position : surface position (rad).
    start_angle : electrical rotor angle (rad).
    """
    state = np.zeros(N_STATE)
    state[THETA_S] = position
    state[THETA_M] = position * actuator.gear.ratio
    state[THETA_E] = start_angle % (2.0 * np.pi)
    state[THETA_0] = state[THETA_E] / actuator.motor.pole_pairs - state[THETA_M]
    state[[LEG_A, LEG_B, LEG_C]] = 1.0
    return state


def restart(state: np.ndarray, actuator: Actuator) -> np.ndarray:
    """Return a state at time 0 and at rest where `state` stands (the inverter was off)."""
    angle = float(state[THETA_E])
    fresh = initial_state(actuator, float(state[THETA_S]), angle)
    fresh[THETA_M] = state[THETA_M]
    fresh[THETA_0] = state[THETA_0]
    return fresh
