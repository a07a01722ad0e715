"""What the start of a single step tells of the transmission, where no reversal does.

While the motor starts, its kinetic energy less the work of its torque is the work of friction
and shaft, E(θ) = ½ J ω² − ∫ T dθ, so −E'' is the stiffness behind the motor: shaft stiffness /
ratio² in contact, zero inside the lost motion. The lag of the surface behind the motor is the
wind-up of the shaft and the lost motion taken up; only differences of it are used. How far the
shaft is wound when a test begins is what the last move has left: the start crosses the whole lost
motion where it is wound against the step, a part of it where it is relaxed, and none where it is
wound along with the step.

How the speed grows tells viscous from dry friction too, which the one speed of a step does not.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ema_prognostics.features.signals import Signals
from ema_sim.rebuild import integral

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
REACH, FAR = 4.0, 8.0
"""Travel of the motor over which the lost motion is sought, of `Actuator.wind_up`, and the viscous
friction, for which it must reach the speed of the slew."""
EVERY = 3
"""So manyth lost motion and wind-up are tried for the friction, which hardly depends on them."""
LEAST_SAMPLES, MOST_SAMPLES = 16, 100
"""Of this travel; more are averaged."""
WOUND = np.linspace(0.1, 3.0, 30)
"""Wind-ups of the shaft in the settled slew that are tried, of `Actuator.wind_up`."""
GAPS = np.concatenate([[0.0], np.geomspace(0.05, 3.0, 40)])
"""Lost motions that are tried, of the same."""
UNIT = (np.array([1.0, 1.0, 1.0, 0.0, 0.0, 1.0]), np.array([0.1, 0.5, 0.5, 1.0, 0.3, 0.2]))
"""Means and deviations of a unit's 1 / inertia, viscous and dry friction (of nominal), energy at
the start (J), damping beyond the nominal one, and stiffness: the tolerances of the default kit,
dry friction as wear raises it."""
LEAST_NOISE, SLOW = 6e-4, 0.025
"""Noise of the speed, at least, and speed below which its share in the energy is as at this one,
of the highest speed."""
STIFF = 60.0
"""Weight of the second differences of the surface's position against its readings: what moves the
surface is smooth over some three samples, the steps of the reading are not."""
LEVEL = 0.1
"""Probability of a lost motion below the least, and above the most."""


def start_stiffness(signals: Signals, length: float) -> np.ndarray:
    """Return the stiffness in each of `PARTS`, relative to the nominal shaft, shape (2,).

    Zero where the record holds too few samples of the travel. `length`: the travel is over by
    then, after the command (s).
    """
    part = signals.between(-1e-3, length)
    motor, shaft = signals.actuator.motor, signals.actuator.shaft
    theta = signals.motor_angle[part]
    torque = signals.torque(part)
    energy = 0.5 * motor.inertia * signals.speed[part] ** 2 - integral(torque, theta)
    travel = np.abs(theta - theta[0]) / signals.actuator.wind_up
    found = np.zeros(len(PARTS))
    for index, (low, high) in enumerate(PARTS):
        inside = (travel > low) & (travel <= high) & (travel > LEAST_TRAVEL)
        if np.count_nonzero(inside) >= MIN_SAMPLES:
            u = (travel[inside] - 0.5 * (low + high)) / (high - low)
            reach = (high - low) * signals.actuator.wind_up
            found[index] = -2.0 * np.polyfit(u, energy[inside], 2)[0] / reach**2
    return found / (shaft.stiffness / signals.actuator.gear.ratio**2)


class StartFit(NamedTuple):
    """What a start shows."""

    least: float
    """Lost motion that explains it at least, and at most (rad)."""
    most: float
    viscous: float
    """Viscous friction of the motor, of nominal, if its inertia is nominal."""


def fit_start(
    signals: Signals, part: slice, lag: np.ndarray, direction: float, reach: float = REACH,
    every: int = 1,
) -> StartFit:
    """Return what explains a start.

    ½ J ω² is the work of the torque less ∫ (viscous + dry friction) dθ and ∫ τ dθ / ratio, with τ
    the stiffness by the twist outside the lost motion and the damping by its rate. For each lost
    motion and each wind-up of the settled slew the rest is linear, with the noise of the speed on
    the left only, and each is weighed by how well it explains ω² (Bishop, Pattern Recognition and
    Machine Learning, 3.3). The surface's position is smoothed first (Whittaker's smoother: Eilers,
    Anal. Chem. 75, 2003). Zero, the largest that is tried and nominal friction where the record
    holds too few samples of the travel.

    Parameters
    ----------
    part : of the signals, in which the motor starts.
    lag : of the surface in it, from that of the settled slew, in the direction of the slew (rad).
    direction : 1 or -1.
    reach : travel of the motor that is explained, of `Actuator.wind_up`.
    every : of `WOUND` and `GAPS`, so manyth is tried.
    """
    a, per_ratio = signals.actuator, 1.0 / signals.actuator.gear.ratio
    wind_ups, gaps = WOUND[::every], GAPS[::every]
    wound = a.wind_up * per_ratio
    theta = direction * (signals.motor_angle[part] - signals.motor_angle[part.start])
    size = int(np.argmax(theta > reach * a.wind_up)) or len(theta)
    many = max(1, math.ceil(size / MOST_SAMPLES))
    size -= size % many
    if size < LEAST_SAMPLES * many:
        return StartFit(0.0, GAPS[-1] * wound, 1.0)

    def means(values: np.ndarray) -> np.ndarray:
        return values[:size].reshape(-1, many).mean(axis=1)

    work = means(integral(direction * signals.torque(part), theta))
    theta, speed, lag = means(theta), means(direction * signals.speed[part]), means(lag)
    bend = np.diff(np.eye(len(theta)), 2, axis=0)
    lag = per_ratio * theta - np.linalg.solve(
        np.eye(len(theta)) + STIFF * bend.T @ bend, per_ratio * theta - lag)
    twist = lag + wound * np.repeat(wind_ups, len(gaps))[:, None]  # beyond the lost motion
    beyond = np.maximum(twist, 0.0) + np.minimum(
        twist + wound * np.tile(gaps, len(wind_ups))[:, None], 0.0)
    shaft = a.shaft.stiffness * integral(beyond, theta) + a.shaft.damping * integral(
        speed * (beyond != 0.0), lag)
    damped = a.shaft.damping * integral(speed, lag)
    motor = a.motor
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(theta)))])
    known = np.stack([work, -motor.viscous_friction * integral(speed, theta),
                      -motor.dynamic_friction * path, np.ones(len(theta)),
                      -per_ratio * damped])
    noise = LEAST_NOISE * a.control.speed_limit
    weight = 1.0 / (motor.inertia * noise * (np.abs(speed) + SLOW * a.control.speed_limit))
    (*means_of, mean), (*deviations, deviation) = UNIT
    rest = (0.5 * motor.inertia * speed**2 - means_of @ known) * weight
    known *= weight * np.array(deviations)[:, None]
    over = np.linalg.solve(known @ known.T + np.eye(len(known)), known)
    shaft *= -per_ratio * weight
    # What `known` does not explain, of each shaft and of the rest; then the shaft's own stiffness.
    free, left = shaft - shaft @ known.T @ over, rest - rest @ known.T @ over
    own, shared = np.sum(free * shaft, axis=1), free @ rest
    cost = left @ rest - 2.0 * mean * shared + mean**2 * own - (
        deviation * (shared - mean * own))**2 / (1.0 + deviation**2 * own)
    likely = np.exp(-0.5 * (cost - cost.min()) / max(float(cost.min()) / len(work), 1.0))
    likely /= likely.sum()
    stiffness = mean + deviation**2 * (shared - mean * own) / (1.0 + deviation**2 * own)
    viscous = over[1] @ rest - likely @ (stiffness * (shaft @ over[1]))
    of_gap = likely.reshape(len(wind_ups), len(gaps)).sum(axis=0)
    least, most = wound * np.interp(
        [LEVEL, 1.0 - LEVEL], np.cumsum(of_gap) - 0.5 * of_gap, gaps)
    return StartFit(float(least), float(most), float(means_of[1] + deviations[1] * viscous))


def start_features(signals: Signals, begin: float, end: float) -> dict[str, float]:
    """Return stiffness, lags and friction of the start by name.

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
    lost = fit_start(signals, part, lag[part] - settled, direction)
    far = fit_start(signals, part, lag[part] - settled, direction, FAR, EVERY)
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
        "start_gap_least": 1e3 * lost.least, "start_gap_most": 1e3 * lost.most,
        "start_viscous": far.viscous,
    }
