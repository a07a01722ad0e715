"""What the start of a single step tells of the transmission, where no reversal does.

While the motor starts, its kinetic energy less the work of its torque is the work of friction
and shaft, E(θ) = ½ J ω² − ∫ T dθ, so −E'' is the stiffness behind the motor: shaft stiffness /
ratio² in contact, zero inside the lost motion. The lag of the surface behind the motor is the
wind-up of the shaft and the lost motion taken up; only differences of it are used. How far the
shaft is wound when a test begins is what the last move has left: the start crosses the whole lost
motion where it is wound against the step, a part of it where it is relaxed, and none where it is
wound along with the step.
"""

from __future__ import annotations

import math

import numpy as np

from ema_prognostics.features.signals import Signals

PARTS = ((0.0, 0.5), (0.5, 1.0))
"""Travel of the motor over which the stiffness is fitted, of `Actuator.wind_up`."""
MIN_SAMPLES = 5
LEAST_TRAVEL = 0.004
SMOOTHING = 5e-4
"""Length of the mean under which the peak of the lag is sought (s)."""
TRAVELS = (0.6, 1.0, 1.4, 1.8, 2.2, 2.8, 3.6, 4.8, 6.4)
"""Travel of the motor at which the lag of the surface is read, ± `NEAR` of it, of
`Actuator.wind_up`."""
NEAR = 0.12
START_SHARE = 0.3
"""Part of the time to the settled slew in which the motor starts."""
REACH = 4.0
"""Travel of the motor over which the lost motion is sought, of `Actuator.wind_up`."""
LEAST_SAMPLES, MOST_SAMPLES = 16, 200
"""Of this travel; more are averaged."""
WOUND = np.linspace(0.1, 3.0, 30)
"""Wind-ups of the shaft in the settled slew that are tried, of `Actuator.wind_up`."""
GAPS = np.concatenate([[0.0], np.geomspace(0.05, 3.0, 20)])
"""Lost motions that are tried, of the same."""
UNIT = (np.array([1.0, 1.0, 1.0, 0.0, 1.0]), np.array([0.1, 0.5, 0.5, 1.0, 0.2]))
"""Means and deviations of a unit's inertia, viscous and dry friction (of nominal), energy at the
start (J) and stiffness: the tolerances of the default kit, dry friction as wear raises it."""
LEAST_NOISE, SLOW = 6e-4, 0.025
"""Noise of the speed, at least, and speed below which its share in the energy is as at this one,
of the highest speed."""
LEVEL = 0.1
"""Probability of a lost motion below the least, and above the most."""


def _integral(values: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Return ∫ values dover from the first sample on, along the last axis.

    By trapezoids, as `scipy.integrate.cumulative_trapezoid`, which takes 0.4 s to load.
    """
    parts = 0.5 * (values[..., 1:] + values[..., :-1]) * np.diff(over)
    return np.concatenate([np.zeros((*parts.shape[:-1], 1)), np.cumsum(parts, axis=-1)], axis=-1)


def start_stiffness(signals: Signals, length: float) -> np.ndarray:
    """Return the stiffness in each of `PARTS`, relative to the nominal shaft, shape (2,).

    Zero where the record holds too few samples of the travel. `length`: the travel is over by
    then, after the command (s).
    """
    part = signals.between(-1e-3, length)
    motor, shaft = signals.actuator.motor, signals.actuator.shaft
    theta = signals.motor_angle[part]
    torque = signals.torque(part)
    energy = 0.5 * motor.inertia * signals.speed[part] ** 2 - _integral(torque, theta)
    travel = np.abs(theta - theta[0]) / signals.actuator.wind_up
    found = np.zeros(len(PARTS))
    for index, (low, high) in enumerate(PARTS):
        inside = (travel > low) & (travel <= high) & (travel > LEAST_TRAVEL)
        if np.count_nonzero(inside) >= MIN_SAMPLES:
            u = (travel[inside] - 0.5 * (low + high)) / (high - low)
            reach = (high - low) * signals.actuator.wind_up
            found[index] = -2.0 * np.polyfit(u, energy[inside], 2)[0] / reach**2
    return found / (shaft.stiffness / signals.actuator.gear.ratio**2)


def start_gap(signals: Signals, part: slice, lag: np.ndarray, direction: float) -> np.ndarray:
    """Return how much lost motion at least and at most explains the start, shape (2,) (rad).

    The work of the torque is ½ J ω² + ∫ (viscous + dry friction) dθ + ∫ τ dθ / ratio, with τ the
    stiffness by the twist outside the lost motion and the damping by its rate. For each lost
    motion and each wind-up of the settled slew the rest is linear, and each is weighed by how well
    it explains the work (Bishop, Pattern Recognition and Machine Learning, 3.3). Zero and the
    largest that is tried where the record holds too few samples of the travel.

    Parameters
    ----------
    part : of the signals, in which the motor starts.
    lag : of the surface in it, from that of the settled slew, in the direction of the slew (rad).
    direction : 1 or -1.
    """
    a, per_ratio = signals.actuator, 1.0 / signals.actuator.gear.ratio
    wound = a.wind_up * per_ratio
    theta = direction * (signals.motor_angle[part] - signals.motor_angle[part.start])
    size = int(np.argmax(theta > REACH * a.wind_up)) or len(theta)
    many = max(1, math.ceil(size / MOST_SAMPLES))
    size -= size % many
    if size < LEAST_SAMPLES * many:
        return np.array([0.0, GAPS[-1] * wound])

    def means(values: np.ndarray) -> np.ndarray:
        return values[:size].reshape(-1, many).mean(axis=1)

    work = means(_integral(direction * signals.torque(part), theta))
    theta, speed, lag = means(theta), means(direction * signals.speed[part]), means(lag)
    twist = lag + wound * np.repeat(WOUND, len(GAPS))[:, None]  # beyond the lost motion
    beyond = np.maximum(twist, 0.0) + np.minimum(
        twist + wound * np.tile(GAPS, len(WOUND))[:, None], 0.0)
    shaft = a.shaft.stiffness * _integral(beyond, theta) + a.shaft.damping * _integral(
        speed * (beyond != 0.0), lag)
    motor = a.motor
    known = np.stack([0.5 * motor.inertia * speed**2,
                      motor.viscous_friction * _integral(speed, theta),
                      motor.dynamic_friction * theta, np.ones(len(theta))])
    terms = np.concatenate([np.broadcast_to(known, (len(twist), *known.shape)),
                            per_ratio * shaft[:, None, :]], axis=1)
    noise = LEAST_NOISE * a.control.speed_limit
    weight = 1.0 / (motor.inertia * noise * (np.abs(speed) + SLOW * a.control.speed_limit))
    mean, deviation = UNIT
    rest = (work - np.tensordot(mean, terms, (0, 1))) * weight
    terms = terms * weight * deviation[:, None]
    moved = np.einsum("gpn,gn->gp", terms, rest)
    found = np.linalg.solve(terms @ terms.transpose(0, 2, 1) + np.eye(len(mean)),
                            moved[..., None])[..., 0]
    cost = np.sum(rest**2, axis=1) - np.sum(moved * found, axis=1)
    scale = max(float(cost.min()) / len(work), 1.0)
    likely = np.exp(-0.5 * (cost - cost.min()) / scale).reshape(len(WOUND), len(GAPS)).sum(axis=0)
    return wound * np.interp([LEVEL, 1.0 - LEVEL], np.cumsum(likely) / likely.sum(), GAPS)


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
    least, most = 1e3 * start_gap(signals, part, lag[part] - settled, direction)
    travel = direction * (theta[part] - theta[part][0]) / signals.actuator.wind_up
    found: dict[str, float] = {}
    last = at_rest
    for k, middle in enumerate(TRAVELS):
        near = np.abs(travel - middle) < NEAR * middle
        last = float(lag[part][near].mean()) if near.any() else last
        found[f"lag_start_{k + 1}"] = 1e3 * (last - settled)
    return found | {
        "lag_at_rest": 1e3 * (at_rest - settled), "lag_peak": 1e3 * (peak - settled),
        "start_stiffness_1": float(first), "start_stiffness_2": float(second),
        "start_gap_least": float(least), "start_gap_most": float(most),
    }
