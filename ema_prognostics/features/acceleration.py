"""Inertia of the motor, from the torque balance while it accelerates and brakes.

Least squares of the motor's torque on acceleration, sense of rotation, speed and the wind-up of
the shaft: T = J dω/dt + F sgn ω + D ω + K/N (θ/N − position) + constant. Friction and stiffness
have coefficients of their own, so J is free of them.
"""

from __future__ import annotations

import numpy as np

from ema_prognostics.features.signals import Signals

LAG = 5e-4
"""Length of the mean over speed, torque and wind-up (s)."""
LEAST_SPEED = 0.02
"""Share of the highest speed below which the friction is not that of a moving motor."""
LEAST_ERROR = 2.4e-3
"""Floor of the remainder, of the torque of nominal friction."""
FLOOR = 0.05
MIN_ROWS = 50


def inertia(signals: Signals, windows: tuple[tuple[float, float], ...]) -> dict[str, float]:
    """Return the inertia and the remainder's size, logarithms over nominal and of N m.

    Parameters
    ----------
    signals : of the record.
    windows : starts and stops (s after the first command).
    """
    motor, ratio = signals.actuator.motor, signals.actuator.gear.ratio
    n = max(2, round(LAG * signals.rate))
    kernel = np.ones(n) / n
    least = LEAST_SPEED * signals.actuator.control.speed_limit
    rows, sides = [], []
    for begin, end in windows:
        part = signals.between(begin, end)
        speed = signals.speed[part]
        torque = signals.torque(part)
        lag = signals.motor_angle[part] / ratio - signals.position[part]
        # The difference over n samples is the mean of the derivative over them.
        rise = (speed[n:] - speed[:-n]) * signals.rate / n
        smooth = [np.convolve(x, kernel, mode="valid") for x in (speed, torque, lag)]
        mean, wanted, wound = (0.5 * (x[1:] + x[:-1]) for x in smooth)
        fast = np.convolve(np.abs(speed), kernel, mode="valid")
        sure = (np.abs(mean) > least) & (fast[1:] > least)
        rows.append(np.column_stack([
            rise, np.sign(mean), mean, wound * signals.actuator.shaft.stiffness / ratio,
            np.ones(len(mean)),
        ])[sure])
        sides.append(wanted[sure])
    x, y = np.vstack(rows), np.concatenate(sides)
    if len(y) < MIN_ROWS:
        return {"inertia": 0.0, "inertia_error": 0.0}
    scale = np.maximum(np.abs(x).max(axis=0), 1e-9)
    found = np.linalg.lstsq(x / scale, y, rcond=None)[0]
    error = float((y - x / scale @ found).std())
    return {"inertia": float(np.log(max(found[0] / scale[0] / motor.inertia, FLOOR))),
            "inertia_error": float(np.log(error + LEAST_ERROR * signals.actuator.friction_torque))}
