"""What the start of a single step tells of the transmission, where no reversal does.

While the motor starts, its kinetic energy less the work of its torque is the work of friction
and shaft, E(θ) = ½ J ω² − ∫ T dθ, so −E'' is the stiffness behind the motor: shaft stiffness /
ratio² in contact, zero inside the lost motion. The lag of the surface behind the motor is the
wind-up of the shaft and the lost motion taken up; only differences of it are used.
"""

from __future__ import annotations

import numpy as np

from ema_prognostics.features.signals import Signals

PARTS = ((0.0, 0.5), (0.5, 1.0))
"""Travel of the motor over which the stiffness is fitted, of `Actuator.wind_up`."""
MIN_SAMPLES = 5
LEAST_TRAVEL = 0.004
SMOOTHING = 5e-4
"""Length of the mean under which the peak of the lag is sought (s)."""
TRAVELS = (0.6, 1.0, 1.4, 1.8, 2.2, 2.8, 3.6, 4.8, 6.4)
"""Travel of the motor at which the lag of the surface is read, ± `REACH` of it, of
`Actuator.wind_up`."""
REACH = 0.12
START_SHARE = 0.3
"""Part of the time to the settled slew in which the motor starts."""


def start_stiffness(signals: Signals, length: float) -> np.ndarray:
    """Return the stiffness in each of `PARTS`, relative to the nominal shaft, shape (2,).

    Zero where the record holds too few samples of the travel. `length`: the travel is over by
    then, after the command (s).
    """
    part = signals.between(-1e-3, length)
    motor, shaft = signals.actuator.motor, signals.actuator.shaft
    theta = signals.motor_angle[part]
    torque = signals.torque(part)
    step = np.diff(theta)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (torque[1:] + torque[:-1]) * step)])
    energy = 0.5 * motor.inertia * signals.speed[part] ** 2 - work
    travel = np.abs(theta - theta[0]) / signals.actuator.wind_up
    found = np.zeros(len(PARTS))
    for index, (low, high) in enumerate(PARTS):
        inside = (travel > low) & (travel <= high) & (travel > LEAST_TRAVEL)
        if np.count_nonzero(inside) >= MIN_SAMPLES:
            u = (travel[inside] - 0.5 * (low + high)) / (high - low)
            reach = (high - low) * signals.actuator.wind_up
            found[index] = -2.0 * np.polyfit(u, energy[inside], 2)[0] / reach**2
    return found / (shaft.stiffness / signals.actuator.gear.ratio**2)


def start_features(signals: Signals, begin: float, end: float) -> dict[str, float]:
    """Return stiffness and lags of the start by name.

    Parameters
    ----------
    signals : of the record.
    begin, end : the settled slew that the lags are counted from (s after the first command).
    """
    slew = signals.between(begin, end)
    theta = signals.motor_angle
    direction = 1.0 if theta[slew][-1] >= theta[slew][0] else -1.0
    lag = direction * (theta / signals.actuator.gear.ratio - signals.position)
    settled = float(lag[slew].mean())
    command = signals.record.profile.command_time
    rest = signals.time < command
    at_rest = float(lag[rest].mean()) if rest.any() else float(lag[0])
    width = max(1, round(SMOOTHING * signals.rate))
    length = START_SHARE * begin
    part = signals.between(0.0, length)
    sums = np.concatenate([[0.0], np.cumsum(lag[part])])
    peak = float(np.max(sums[width:] - sums[:-width]) / width)
    first, second = start_stiffness(signals, 0.4 * length)
    travel = direction * (theta[part] - theta[part][0]) / signals.actuator.wind_up
    found: dict[str, float] = {}
    last = at_rest
    for k, middle in enumerate(TRAVELS):
        near = np.abs(travel - middle) < REACH * middle
        last = float(lag[part][near].mean()) if near.any() else last
        found[f"lag_start_{k + 1}"] = 1e3 * (last - settled)
    return found | {
        "lag_at_rest": 1e3 * (at_rest - settled), "lag_peak": 1e3 * (peak - settled),
        "start_stiffness_1": float(first), "start_stiffness_2": float(second),
    }
