"""What the transmission does: lag of the surface behind the motor, and the start.

The motor's travel divided by the gear ratio, minus the surface's, is the wind-up of the shaft
plus the lost motion taken up. Only differences of it are used, so no absolute angle is needed.
"""

from __future__ import annotations

import numpy as np

from ema_record.channels import MOTOR_SPEED, ROTOR_ANGLE, SURFACE_POSITION
from ema_record.record import Record

SMOOTHING = 5e-4
"""Length of the mean under which the peak of the lag is sought (s)."""
START_LENGTH = 0.03
"""Part of the record after the command in which the motor starts (s)."""


def transmission_lag(record: Record, gear_ratio: float) -> np.ndarray:
    """Return motor travel / gear ratio − surface position, shape (n,) (rad); any constant."""
    theta = np.unwrap(record.samples[:, ROTOR_ANGLE])
    return theta / gear_ratio - record.samples[:, SURFACE_POSITION]


def mean_between(record: Record, signal: np.ndarray, begin: float, end: float) -> float:
    """Return the mean of `signal`, shape (n,), between two times (s)."""
    first, last = np.searchsorted(record.time, (begin, end))
    return float(signal[first:last].mean())


def peak_after(record: Record, signal: np.ndarray, begin: float, length: float) -> float:
    """Return the largest running mean of `signal` within `length` after `begin` (s)."""
    first, last = np.searchsorted(record.time, (begin, begin + length))
    width = max(1, round(SMOOTHING * record.rate))
    sums = np.concatenate([[0.0], np.cumsum(signal[first:last])])
    return float(np.max(sums[width:] - sums[:-width]) / width)


def rise_time(record: Record, begin: float, speed: float, part: float = 0.9) -> float:
    """Return when the motor speed passes `part` of `speed` (rad/s) after `begin` (s), in s.

    The last passing below counts, interpolated; `START_LENGTH` where it is not reached.
    """
    first, last = np.searchsorted(record.time, (begin, begin + START_LENGTH))
    omega = np.abs(record.samples[first:last, MOTOR_SPEED])
    below = np.flatnonzero(omega < part * speed)
    if len(below) == 0:
        return 0.0
    k = int(below[-1])
    if k + 1 >= len(omega):
        return START_LENGTH
    time = record.time[first + k:first + k + 2]
    share = (part * speed - omega[k]) / (omega[k + 1] - omega[k])
    return float(time[0] + share * (time[1] - time[0]) - begin)
