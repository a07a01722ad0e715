"""State of the actuator between two calls of the kernel: one float array, indices by name."""

from __future__ import annotations

import numpy as np

from ema_record.actuator import Actuator

(
    TIME, I_A, I_B, I_C, OMEGA_M, THETA_M, OMEGA_S, THETA_S, THETA_E, LEG_A, LEG_B, LEG_C,
    ALPHA_M, ALPHA_S, I_SET, INTEGRAL, SPEED_NOISE, POSITION_NOISE, TICK, SAMPLE, THETA_0,
    STEPS, CHARGE, E_TERMINAL, E_COPPER, E_MOTOR, E_FRICTION_M, E_FRICTION_S, E_SHAFT, E_LOAD,
    I_ACT, SECTOR, EDGE, DIRECTION, SHAFT_TORQUE, MOTOR_LOAD, CARRIER, U_A, U_B, U_C,
    SET_NEXT, SET_AT, ACT_NEXT, ACT_AT, I_BUS, ACTING, HISTORY,
) = range(47)  # fmt: skip
"""`I_SET` is the reference current as recorded, `I_ACT` as it acts; what follows each, and when
(infinite: in this control period nothing). `SECTOR`, `EDGE`, `DIRECTION` are of the commutation,
`ACTING` is its sector as it acts, the angle to the next edge of either 0 where that is not known
yet. The torques of the shaft (N m), on the surface and on the motor, are not numbers before the
first step. With a carrier the states of the legs are their means over its period, `CARRIER` counts
those that have begun, and U are the integrals of the current control (V; in the rotor's axes: d, q
and none). `I_BUS` is the current of the source (A)."""

N_HISTORY = 512
"""Reference currents kept for their delay, one a control period: the longest is 2 ms of the
effect in the shortest periods and the longest latency, 300."""
N_STATE = HISTORY + N_HISTORY


def initial_state(
    actuator: Actuator, position: float, start_angle: float, twist: float = 0.0
) -> np.ndarray:
    """Return the state at rest, no current.

    Parameters
    ----------
    actuator : parameters.
    position, twist : of surface and shaft (rad).
    start_angle : electrical rotor angle (rad), of one of the turns that make a mechanical one.
    """
    state = np.zeros(N_STATE)
    state[THETA_S] = position
    state[THETA_M] = (position + twist) * actuator.gear.ratio
    turn, pairs = 2.0 * np.pi, actuator.motor.pole_pairs
    state[THETA_E] = start_angle % turn
    state[THETA_0] = start_angle % (turn * pairs) / pairs - state[THETA_M]
    state[[LEG_A, LEG_B, LEG_C]] = 1.0
    state[[SHAFT_TORQUE, MOTOR_LOAD]] = np.nan
    state[[SET_AT, ACT_AT]] = np.inf
    return state


def restart(state: np.ndarray, actuator: Actuator) -> np.ndarray:
    """Return a state at time 0 and at rest where `state` stands (the inverter was off)."""
    angle = float(state[THETA_E])
    fresh = initial_state(actuator, float(state[THETA_S]), angle)
    fresh[THETA_M] = state[THETA_M]
    fresh[THETA_0] = state[THETA_0]
    return fresh
