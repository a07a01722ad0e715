"""Signals of a record on the actuator's own scale, and means and spreads of their sections.

Errors of the current sensors are removed; torque current, travel and lag follow. All that goes
over the samples is compiled: some six hundred runs are made for one record.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit

from ema_record.actuator import Actuator
from ema_record.channels import (
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
)
from ema_record.record import Record
from ema_sim.machine import TURN, unit_trapezoid

TABLE = 3 * 2**15
"""Angles of the table of the trapezoid."""
CURRENT, REFERENCE = PHASE_CURRENTS.start, REFERENCE_CURRENTS.start
ROOM = 10
"""Rows of signals that are computed of a record."""
SPEED, POSITION, Q, LAG, ERROR = 1, 3, 5, 6, 7
"""Some of them."""
EIGHT = 8
"""Samples over which the hunting of the speed is smoothed."""
TINY = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveSignals:
    """A record as the features need it; arrays have shape (n,) unless said.

    Attributes
    ----------
    time : s.
    speed : motor (rad/s).
    theta : electrical rotor angle, unwrapped (rad).
    position : surface (rad).
    error : phase currents as read minus their references, shape (n, 3) (A).
    total : sum of the currents as read, without their offsets (A).
    torque_current : q = Σ trapezoid_k i_k / 2, of corrected currents (A).
    lag : motor travel through the gear minus surface position, 0 while the inverter is off (rad).
    offset : of the current sensors, read while the inverter is off, shape (3,) (A).
    gain : of the current sensors relative to their mean, shape (3,).
    pole_pairs : 1.
    rows : all of them that have shape (n,), one below another, shape (10, n).
    """

    time: np.ndarray
    speed: np.ndarray
    theta: np.ndarray
    position: np.ndarray
    error: np.ndarray
    total: np.ndarray
    torque_current: np.ndarray
    lag: np.ndarray
    offset: np.ndarray
    gain: np.ndarray
    pole_pairs: int
    rows: np.ndarray

    def between(self, begin: float, end: float) -> slice:
        """Return the samples between two times (s)."""
        first, last = np.searchsorted(self.time, (begin, end))
        return slice(int(first), int(last))


@lru_cache(maxsize=8)
def _table(flat_top: float) -> np.ndarray:
    """Return half the trapezoid at the middles of `TABLE` parts of a turn."""
    return 0.5 * unit_trapezoid((np.arange(TABLE) + 0.5) * (TURN / TABLE), flat_top)


@njit(cache=True, error_model="numpy", nogil=True)
def _signals(
    samples: np.ndarray, offset: np.ndarray, gain: np.ndarray, table: np.ndarray, travel: float,
    out: np.ndarray,
) -> None:
    """Fill the rows of `out`, shape (10, n), with time, speed, theta and so on as `DriveSignals`.

    `travel` is that of the surface a radian of the electrical angle; the lag has its offset still.
    The angle is that of `numpy.unwrap`, the trapezoid is read in a table.
    """
    n, third = len(table), len(table) // 3
    per_a, per_b, per_c = 1.0 / gain[0], 1.0 / gain[1], 1.0 / gain[2]
    correction = 0.0
    for i in range(len(samples)):
        if i > 0:
            step = samples[i, ROTOR_ANGLE] - samples[i - 1, ROTOR_ANGLE]
            if abs(step) >= np.pi:
                wrapped = (step + np.pi) % TURN - np.pi
                if wrapped == -np.pi and step > 0.0:
                    wrapped = np.pi
                correction += wrapped - step
        theta = samples[i, ROTOR_ANGLE] + correction
        place = np.floor(theta * (n / TURN))
        at_a = int(place - n * np.floor(place / n))
        at_b = at_a - third if at_a >= third else at_a - third + n
        at_c = at_b - third if at_b >= third else at_b - third + n
        read_a, read_b = samples[i, CURRENT], samples[i, CURRENT + 1]
        read_c = samples[i, CURRENT + 2]
        i_a, i_b, i_c = read_a - offset[0], read_b - offset[1], read_c - offset[2]
        q = (table[at_a] * (i_a * per_a) + table[at_b] * (i_b * per_b)
             + table[at_c] * (i_c * per_c))
        out[ERROR, i] = read_a - samples[i, REFERENCE]
        out[ERROR + 1, i] = read_b - samples[i, REFERENCE + 1]
        out[ERROR + 2, i] = read_c - samples[i, REFERENCE + 2]
        total = i_a + i_b + i_c
        out[0, i], out[1, i], out[2, i] = samples[i, TIME], samples[i, MOTOR_SPEED], theta
        out[3, i], out[4, i], out[5, i] = samples[i, SURFACE_POSITION], total, q
        out[6, i] = theta * travel - samples[i, SURFACE_POSITION]


@njit(cache=True, error_model="numpy", nogil=True)
def _moments(samples: np.ndarray, begin: int, offset: np.ndarray) -> np.ndarray:
    """Return Σ i iᵀ of the currents less their offsets from sample `begin` on, shape (3, 3)."""
    found = np.zeros((3, 3))
    for i in range(begin, len(samples)):
        for k in range(3):
            for m in range(k, 3):
                found[k, m] += (samples[i, CURRENT + k] - offset[k]) * (
                    samples[i, CURRENT + m] - offset[m])
    return found + np.triu(found, 1).T


def sensor_errors(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Return offsets (A) and relative gains of the current sensors, each of shape (3,).

    The offsets are the readings while the inverter is off; the gains make the sum of the
    currents vanish, as it does in a star (smallest eigenvector of ⟨i iᵀ⟩).
    """
    rest = record.samples[record.at_rest, PHASE_CURRENTS]
    offset = rest.mean(axis=0) if len(rest) else np.zeros(3)
    _, vectors = np.linalg.eigh(_moments(record.samples, record.at_rest.stop, offset))
    normal = np.abs(vectors[:, 0])
    gain = 1.0 / normal if normal.min() > 0.2 else np.ones(3)
    return offset, gain / gain.mean()


def drive_signals(
    record: Record, actuator: Actuator, room: np.ndarray | None = None
) -> DriveSignals:
    """Return the signals of a record; `actuator` gives flat top, gear and pole pairs.

    `room` : ndarray, shape (10, n), for the signals; default a new one.
    """
    offset, gain = sensor_errors(record)
    room = np.empty((ROOM, len(record))) if room is None else room
    pairs = actuator.motor.pole_pairs
    _signals(record.samples, offset, gain, _table(actuator.motor.flat_top),
             1.0 / (pairs * actuator.gear.ratio), room)
    time, speed, theta, position, total, q, lag = room[:7]
    lag -= lag[:max(int(np.searchsorted(time, record.profile.inverter_off)), 1)].mean()
    return DriveSignals(
        time=time, speed=speed, theta=theta, position=position, error=room[7:].T, total=total,
        torque_current=q, offset=offset, gain=gain, lag=lag, pole_pairs=pairs,
        rows=room)


_kept = threading.local()


def kept_room(n: int) -> np.ndarray:
    """Return this thread's room for the signals of `n` samples: new memory costs time."""
    room = getattr(_kept, "room", None)
    if room is None or room.shape[1] != n:
        room = _kept.room = np.empty((ROOM, n))
    return np.asarray(room)


@njit(cache=True, error_model="numpy", nogil=True)
def travels(time: np.ndarray, speed: np.ndarray, theta: np.ndarray) -> tuple[float, float]:
    """Return the travel as the speed sensor reads it, and the length of that of `theta` (rad)."""
    read = length = 0.0
    for i in range(len(time) - 1):
        read += 0.5 * (speed[i + 1] + speed[i]) * (time[i + 1] - time[i])
        length += abs(theta[i + 1] - theta[i])
    return read, length


@njit(cache=True, error_model="numpy", nogil=True)
def roughness(values: np.ndarray) -> float:
    """Return the standard deviation of the differences of neighbours."""
    n, power = len(values) - 1, 0.0
    if n < 1:
        return np.nan
    mean = (values[n] - values[0]) / n
    for i in range(n):
        step = values[i + 1] - values[i] - mean
        power += step * step
    return float(np.sqrt(power / n))


@njit(cache=True, error_model="numpy", nogil=True)
def section_numbers(
    rows: np.ndarray, begin: int, end: int
) -> tuple[float, float, float, float, float]:
    """Return means of q (A), ω (rad/s) and lag (rad), slopes of q and lag over the position.

    `rows` : as in `DriveSignals`, of which samples `begin` to `end` count.
    """
    n = end - begin
    q = speed = lag = position = 0.0
    for i in range(begin, end):
        q, speed = q + rows[Q, i], speed + rows[SPEED, i]
        lag, position = lag + rows[LAG, i], position + rows[POSITION, i]
    q, speed, lag, position = q / n, speed / n, lag / n, position / n
    power = q_slope = lag_slope = 0.0
    for i in range(begin, end):
        beyond = rows[POSITION, i] - position
        power += beyond * beyond
        q_slope += beyond * (rows[Q, i] - q)
        lag_slope += beyond * (rows[LAG, i] - lag)
    return q, speed, lag, q_slope / (power + TINY), lag_slope / (power + TINY)


@njit(cache=True, error_model="numpy", nogil=True)
def spreads(rows: np.ndarray, begin: int, end: int) -> np.ndarray:
    """Return the standard deviations of the differences of neighbours, shape (6,).

    Of q, of ω, of means of ω over `EIGHT` samples, and of the errors of the three currents.
    `rows` : as in `DriveSignals`, of which samples `begin` to `end` count.
    """
    found = np.empty(6)
    smooth = np.zeros((end - begin) // EIGHT)
    for i in range(len(smooth) * EIGHT):
        smooth[i // EIGHT] += rows[SPEED, begin + i]
    found[0], found[1] = roughness(rows[Q, begin:end]), roughness(rows[SPEED, begin:end])
    found[2] = roughness(smooth) / EIGHT
    for k in range(3):
        found[3 + k] = roughness(rows[ERROR + k, begin:end])
    return found


@njit(cache=True, error_model="numpy", nogil=True)
def between_edges(values: np.ndarray, bounds: np.ndarray, carried: bool) -> np.ndarray:
    """Return the means of `values` from each bound to the next, shape (len(bounds) - 1,).

    Of none it is 0; if `carried` the mean before, at first the first value.
    """
    found = np.zeros(len(bounds) - 1)
    last = values[0] if carried and len(values) > 0 else 0.0
    for k in range(len(found)):
        first, end = bounds[k], bounds[k + 1]
        if end > first:
            last = 0.0
            for i in range(first, end):
                last += values[i]
            last /= end - first
        elif not carried:
            last = 0.0
        found[k] = last
    return found
