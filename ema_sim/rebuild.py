"""Channels that a recorder does not have, from those that it has.

Time, motor speed and two phase currents are always there. The third current follows from the
star point, the position from the speed through the gear, the angle from speed and currents, the
references from the currents themselves.

The angle: the current vector i = ⅔ Σ i_k exp(j k 120°) of a machine that is driven along its
torque axis is −j I exp(jθ) on the mean over a commutation, I of either sign. Its square knows no
sign: the speed, integrated, with the start angle and the offset of the speed that turn i² to one
side, is θ up to half a turn. Which half: the torque must accelerate the rotor, and no friction
drives.
"""

from __future__ import annotations

import numpy as np

from ema_record.actuator import FOC, RELAY, Actuator
from ema_record.channels import (
    MOTOR_SPEED,
    N_CHANNELS,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
)
from ema_record.errors import InvalidRecordError
from ema_record.record import Record
from ema_sim.machine import FIRST_EDGE, SECTOR, SECTOR_SIGNS, THIRD, TURN

TRIES, ROUNDS = 41, 4
"""Speed offsets tried each round; rounds, each a fifth as wide as the one before."""
BLOCK_ANGLE = 0.02
"""Largest turn (rad) by the offset that is looked for within what is summed before the search."""


def present(record: Record) -> np.ndarray:
    """Return which channels were recorded, bool, shape (10,)."""
    if not len(record):
        return np.ones(N_CHANNELS, dtype=bool)
    there = ~np.isnan(record.samples[0])
    there[~there] = ~np.isnan(record.samples[:, ~there]).all(axis=0)
    return there


def completed(record: Record, actuator: Actuator) -> np.ndarray:
    """Return the samples of `record` with all channels, shape (n, 10).

    Parameters
    ----------
    record : channels that were not recorded are NaN throughout.
    actuator : what was tested.

    Raises
    ------
    InvalidRecordError
        A channel is missing from which nothing else can be told.
    """
    there = present(record)
    if there.all():
        return record.samples
    out = record.samples.copy()
    currents = range(PHASE_CURRENTS.start, PHASE_CURRENTS.stop)
    lost = [k for k in currents if not there[k]]
    if not there[TIME] or not there[MOTOR_SPEED] or len(lost) > 1:
        raise InvalidRecordError(
            "time, motor speed and two phase currents are needed: record them")
    if lost:
        others = [k for k in currents if k not in lost]
        rest = out[record.at_rest][:, others]
        offset = rest.mean(axis=0) if len(rest) > 8 else np.zeros(2)
        out[:, lost[0]] = -(out[:, others] - offset).sum(axis=1)
    if not there[ROTOR_ANGLE]:
        out[:, ROTOR_ANGLE] = _angle(out, actuator)
    if not there[SURFACE_POSITION]:
        turned = integral(out[:, MOTOR_SPEED], out[:, TIME])
        out[:, SURFACE_POSITION] = record.profile.start + turned / actuator.gear.ratio
    if not there[REFERENCE_CURRENTS].all():
        out[:, REFERENCE_CURRENTS] = _references(out, actuator)
    return out


def torque_signs(theta: np.ndarray, actuator: Actuator) -> np.ndarray:
    """Return the reference currents of a unit of torque current at angles, shape (n, 3)."""
    if actuator.drive.kind == FOC:
        return np.sin(theta[:, None] - THIRD * np.arange(3))
    place = np.floor((theta - FIRST_EDGE) / SECTOR).astype(int) % 6
    return np.asarray(SECTOR_SIGNS[place])


def torque_command(references: np.ndarray, theta: np.ndarray, actuator: Actuator) -> np.ndarray:
    """Return the torque current, shape (n,) (A), that reference currents, shape (n, 3), ask for.

    Six-step: two phases carry it; sinusoidal: its amplitude.
    """
    share = 2.0 / 3.0 if actuator.drive.kind == FOC else 0.5
    return share * (torque_signs(theta, actuator) * references).sum(axis=1)


def integral(values: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Return ∫ values dover from the first sample on, along the last axis.

    By trapezoids, as `scipy.integrate.cumulative_trapezoid`, which takes 0.4 s to load.
    """
    parts = 0.5 * (values[..., 1:] + values[..., :-1]) * np.diff(over)
    return np.concatenate([np.zeros((*parts.shape[:-1], 1)), np.cumsum(parts, axis=-1)], axis=-1)


def _angle(samples: np.ndarray, actuator: Actuator) -> np.ndarray:
    """Return the electrical angle in [0, 2π), shape (n,) (rad), of speed and currents."""
    time, speed = samples[:, TIME], samples[:, MOTOR_SPEED]
    pairs = actuator.motor.pole_pairs
    turned = pairs * integral(speed, time)
    vector = samples[:, PHASE_CURRENTS] @ np.exp(1j * THIRD * np.arange(3)) * (2.0 / 3.0)
    square = vector**2 * np.exp(-2j * turned) * _along(vector, pairs * speed, actuator)
    if np.abs(vector).max() <= 0.0:
        raise InvalidRecordError("no current flows: the rotor angle cannot be told from it")
    # Offset of the speed sensor: half a quantum of its converter and a noise that is white.
    reach = pairs * max(actuator.converters.speed_range / 2.0**actuator.converters.speed_bits,
                        1e-3 * actuator.control.speed_limit)
    middle = time - time.mean()
    best = 0.0
    period = max(float(np.median(np.diff(time))), 1e-9)
    block = max(1, int(BLOCK_ANGLE / (2.0 * reach * period)))
    first = np.arange(0, len(time), block)
    sums, places = np.add.reduceat(square, first), np.add.reduceat(middle, first)
    places /= np.diff(first, append=len(time))
    for _ in range(ROUNDS):
        tried = best + np.linspace(-reach, reach, TRIES)
        size = np.abs(np.exp(-2j * tried[:, None] * places) @ sums)
        best, reach = float(tried[int(np.argmax(size))]), reach / 5.0
    mean = np.mean(square * np.exp(-2j * best * middle))
    theta = turned + best * middle + 0.5 * np.angle(-mean)
    torque = (vector * 1j * np.exp(-1j * theta)).real
    n = max(2, round(1e-3 / period))
    kernel = np.ones(n) / n
    smooth = np.convolve(torque, kernel, mode="valid")
    pace = np.convolve(speed, kernel, mode="valid")
    gain = np.gradient(pace)
    motor = actuator.motor
    needed = (motor.inertia * gain / period
              + actuator.friction_torque * np.sign(pace)
              * (np.abs(pace) > 0.01 * actuator.control.speed_limit))
    return np.mod(theta if smooth @ needed >= 0.0 else theta + np.pi, TURN)


def _along(vector: np.ndarray, turning: np.ndarray, actuator: Actuator) -> np.ndarray:
    """Return how much each current tells of the torque axis, shape (n,): 1, less of a `PWM` drive.

    A PI control of phases lets the back-EMF drive a current across it, e / |R + jwL + Kp + Ki/jw|.
    """
    motor, drive = actuator.motor, actuator.drive
    if drive.kind in (RELAY, FOC):
        return np.ones(len(vector))
    w = np.maximum(np.abs(turning), 1e-3)
    stiff = np.abs(motor.phase_resistance + drive.proportional_gain + 1j * (
        w * motor.phase_inductance - drive.integral_gain / w))
    across = motor.back_emf_constant * w / motor.pole_pairs / stiff
    return 1.0 / (1.0 + (10.0 * across / np.maximum(np.abs(vector), 1e-9)) ** 4)


def _references(samples: np.ndarray, actuator: Actuator) -> np.ndarray:
    """Return reference currents, shape (n, 3) (A): the torque current that flows, commutated."""
    theta = samples[:, ROTOR_ANGLE]
    wanted = torque_command(samples[:, PHASE_CURRENTS], theta, actuator)
    return torque_signs(theta, actuator) * wanted[:, None]
