"""Signals of a record on the actuator's own scale, and their lines in rotor angle.

Errors of the current sensors are removed; torque current, travel and lag follow. Lines are
complex amplitudes against the rotor angle, seen through a Hann window in angle: it keeps drift and
decaying transients out, so that the lines do not depend on the angle at which a segment begins.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

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
from ema_sim.machine import unit_trapezoid

TURN = 2.0 * np.pi
TABLE = 3 * 2**15
"""Angles of the table of the trapezoid."""
OFF_GUARD = 1e-3
"""Left out before the inverter switches on (s)."""
CURRENT, REFERENCE = PHASE_CURRENTS.start, REFERENCE_CURRENTS.start
ROOM = 10
"""Rows of signals that are computed of a record."""


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
        place = int(np.floor(theta * (n / TURN))) % n
        q = total = 0.0
        for k in range(3):
            read = samples[i, CURRENT + k]
            out[7 + k, i] = read - samples[i, REFERENCE + k]
            current = read - offset[k]
            total += current
            q += table[place] * (current / gain[k])
            place += n - third if place < third else -third
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
    off = int(np.searchsorted(record.time, record.profile.inverter_off - OFF_GUARD))
    offset = record.samples[:off, PHASE_CURRENTS].mean(axis=0) if off else np.zeros(3)
    _, vectors = np.linalg.eigh(_moments(record.samples, off, offset))
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
        torque_current=q, offset=offset, gain=gain, lag=lag, pole_pairs=pairs)


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
def slip_of(time: np.ndarray, speed: np.ndarray, theta: np.ndarray, pairs: int) -> np.ndarray:
    """Return measured travel less that of the rotor angle, (n,) (rad), from 0 to 0.

    The speed counts with half the time between its neighbours.
    """
    n, travel = len(time), 0.0
    found = np.empty(n)
    for i in range(n):
        before, after = max(i - 1, 0), min(i + 1, n - 1)
        travel += speed[i] * ((time[after] - time[before]) / (after - before))
        found[i] = travel * pairs - theta[i]
    first, rise = found[0], (found[n - 1] - found[0]) / (n - 1)
    for i in range(n):
        found[i] -= first + rise * i
    return found


BINS = 2048
"""Angles are rounded to this part of a turn; line 64 loses 0.2 % by it."""
FEWEST = 40
"""Fewest samples for lines."""


class RotorTurns(NamedTuple):
    """Samples of whole turns (of all, if there are fewer than two), and their weights."""

    part: slice
    theta: np.ndarray
    """rad, unwrapped."""
    share: np.ndarray
    """Of the angle; sums to 1."""
    window: np.ndarray
    """Hann in angle times share; sums to 1."""


def turns_of(theta: np.ndarray, part: slice) -> RotorTurns | None:
    """Return the last whole turns of `part`, or all of it below two; None if it hardly moves."""
    angle = theta[part]
    if len(angle) < FEWEST:
        return None
    travel = float(angle[-1] - angle[0])
    if abs(travel) < 0.8 * TURN or len(angle) < 16 * abs(travel) / TURN:
        return None
    sense = np.sign(travel)
    if abs(travel) >= 2.0 * TURN:
        begin = angle[-1] - sense * TURN * int(abs(travel) / TURN)
        first = int(np.argmax(sense * (angle - begin) >= 0.0))
        part = slice(part.start + first, part.stop)
        angle = angle[first:]
        travel = float(angle[-1] - angle[0])
    share, window = _weights(angle)
    return RotorTurns(part, angle, share, window)


@njit(cache=True, error_model="numpy", nogil=True)
def _weights(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return share and window of `RotorTurns`."""
    n, whole = len(angle), 0.0
    share, window = np.empty(n), np.empty(n)
    per = 1.0 / (angle[n - 1] - angle[0])
    for i in range(n):
        low = angle[0] if i == 0 else 0.5 * (angle[i] + angle[i - 1])
        high = angle[i] if i == n - 1 else 0.5 * (angle[i + 1] + angle[i])
        share[i] = (high - low) * per
        window[i] = share[i] * (1.0 - np.cos(TURN * (angle[i] - angle[0]) * per))
        whole += window[i]
    return share, window / whole


def lines(turns: RotorTurns, signals: np.ndarray, highest: int) -> np.ndarray:
    """Return the weighted means of x e^{-jhθ}, shape (highest + 1, m), complex.

    Line 0 is the mean over the angle; the others are of the signal without mean and slope.

    Parameters
    ----------
    turns : the turns.
    signals : ndarray, shape (n, m), real, of the samples of the turns.
    highest : h runs from 0 to it.
    """
    folded, mean = _folded(signals, turns.theta, turns.share, turns.window)
    found = np.fft.rfft(folded, axis=0)[:highest + 1]
    found[0] = mean
    return np.asarray(found)


@njit(cache=True, error_model="numpy", nogil=True)
def _folded(
    signals: np.ndarray, theta: np.ndarray, share: np.ndarray, window: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the windowed signals, without mean and slope, summed in bins, (BINS, m); means, (m,).

    All is summed in one pass over the samples: mean and slope are taken off the bins.
    """
    n, m = signals.shape
    found, mean = np.zeros((BINS, m)), np.zeros(m)
    weight, arm = np.zeros(BINS), np.zeros(BINS)
    level, tilt = np.zeros(m), np.zeros(m)
    first = square = 0.0
    for i in range(n):
        place = int(np.floor(theta[i] * (BINS / TURN) + 0.5)) % BINS
        beyond = theta[i] - theta[0]
        part = window[i] * beyond
        weight[place] += window[i]
        arm[place] += part
        first += part
        square += part * beyond
        for k in range(m):
            x = signals[i, k]
            mean[k] += share[i] * x
            level[k] += window[i] * x
            tilt[k] += part * x
            found[place, k] += window[i] * x
    for k in range(m):
        slope = (tilt[k] - first * level[k]) / (square - first * first)
        for place in range(BINS):
            found[place, k] -= level[k] * weight[place] + slope * (
                arm[place] - first * weight[place])
    return found, mean


def rotor_lines(
    signals: DriveSignals, part: slice, actuator: Actuator
) -> Iterator[tuple[str, str, str, float]]:
    """Yield key, signal, abscissa and value of each line that is not an electrical one.

    Eccentricity and run-out come once a turn and beside the windings' even lines (as
    `ema_prognostics.features.balance` has them), the teeth of a wheel at any whole number.
    """
    pairs = signals.pole_pairs
    orders = [h for h in (*range(1, 2 * pairs + 2), 4 * pairs - 1, 4 * pairs + 1) if h % pairs]
    turns = turns_of(signals.theta / pairs, part)
    if turns is None:
        found = np.zeros((4 * pairs + 2, 2), dtype=complex)
    else:
        stack = np.column_stack([signals.torque_current[turns.part], signals.speed[turns.part]])
        found = lines(turns, stack, 4 * pairs + 1)
    accelerating = 1j * np.arange(len(found)) * actuator.motor.inertia * found[0, 1].real
    torque = 2.0 * actuator.motor.back_emf_constant * found[:, 0] - accelerating * found[:, 1]
    for h in orders:
        for half, of in (("re", np.real), ("im", np.imag)):
            yield (f"turn_torque_line_{h}_{half}", "motor torque", "rotor angle",
                   1e3 * float(of(torque[h])))
            yield (f"turn_speed_line_{h}_{half}", "motor speed", "rotor angle",
                   float(of(found[h, 1])))
