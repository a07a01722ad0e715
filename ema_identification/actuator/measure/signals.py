"""Signals of a record on the actuator's own scale, and their lines in rotor angle.

Errors of the current sensors are removed; torque current, travel and lag follow. Lines are
complex amplitudes against the rotor angle, seen through a Hann window in angle: it keeps drift and
decaying transients out, so that the lines do not depend on the angle at which a segment begins.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from ema_record.actuator import Actuator
from ema_record.channels import PHASE_CURRENTS, REFERENCE_CURRENTS
from ema_record.record import Record
from ema_sim.machine import unit_trapezoid

TURN = 2.0 * np.pi
TABLE = 3 * 2**15
"""Angles of the table of the trapezoid."""
OFF_GUARD = 1e-3
"""Left out before the inverter switches on (s)."""


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


@njit(cache=True, nogil=True)
def _currents(
    theta: np.ndarray, samples: np.ndarray, first: int, offset: np.ndarray, gain: np.ndarray,
    table: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return torque current and sum of the currents in columns `first` on, each (n,) (A).

    The sum is of the currents without offset, the torque current of those corrected by the gain
    too, by a table of the trapezoid.
    """
    n, third = len(table), len(table) // 3
    q, total = np.empty(len(theta)), np.empty(len(theta))
    for i in range(len(theta)):
        place = int(np.floor(theta[i] * (n / TURN))) % n
        q[i] = total[i] = 0.0
        for k in range(3):
            current = samples[i, first + k] - offset[k]
            total[i] += current
            q[i] += table[place] * (current / gain[k])
            place += n - third if place < third else -third
    return q, total


@njit(cache=True, error_model="numpy", nogil=True)
def unwrapped(angle: np.ndarray) -> np.ndarray:
    """Return an angle without jumps of a turn, shape (n,) (rad): `numpy.unwrap` in one pass."""
    found = np.empty(len(angle))
    correction = 0.0
    for i in range(len(angle)):
        if i > 0:
            step = angle[i] - angle[i - 1]
            if abs(step) >= np.pi:
                wrapped = (step + np.pi) % TURN - np.pi
                if wrapped == -np.pi and step > 0.0:
                    wrapped = np.pi
                correction += wrapped - step
        found[i] = angle[i] + correction
    return found


def sensor_errors(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Return offsets (A) and relative gains of the current sensors, each of shape (3,).

    The offsets are the readings while the inverter is off; the gains make the sum of the
    currents vanish, as it does in a star (smallest eigenvector of ⟨i iᵀ⟩).
    """
    currents = record.samples[:, PHASE_CURRENTS]
    off = int(np.searchsorted(record.time, record.profile.inverter_off - OFF_GUARD))
    offset = currents[:off].mean(axis=0) if off else np.zeros(3)
    on = currents[off:] - offset
    _, vectors = np.linalg.eigh(on.T @ on)
    normal = np.abs(vectors[:, 0])
    gain = 1.0 / normal if normal.min() > 0.2 else np.ones(3)
    return offset, gain / gain.mean()


def drive_signals(record: Record, actuator: Actuator) -> DriveSignals:
    """Return the signals of a record; `actuator` gives flat top, gear and pole pairs."""
    samples = record.samples
    offset, gain = sensor_errors(record)
    theta = unwrapped(record.channel("rotor_angle"))
    q, total = _currents(theta, samples, PHASE_CURRENTS.start, offset, gain,
                         _table(actuator.motor.flat_top))
    position = np.ascontiguousarray(record.channel("surface_position"))
    travel = theta / (actuator.motor.pole_pairs * actuator.gear.ratio)
    lag = travel - position
    still = record.time < record.profile.inverter_off
    return DriveSignals(
        time=record.time, speed=np.ascontiguousarray(record.channel("motor_speed")), theta=theta,
        position=position,
        error=samples[:, PHASE_CURRENTS] - samples[:, REFERENCE_CURRENTS], total=total,
        torque_current=q, offset=offset, gain=gain,
        lag=lag - (lag[still].mean() if still.any() else lag[0]),
        pole_pairs=actuator.motor.pole_pairs,
    )


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
    edges = np.empty(len(angle) + 1)
    edges[1:-1] = 0.5 * (angle[1:] + angle[:-1])
    edges[0], edges[-1] = angle[0], angle[-1]
    share = np.diff(edges) / travel
    window = share * (1.0 - np.cos(TURN * (angle - angle[0]) / travel))
    return RotorTurns(part, angle, share, window / window.sum())


def lines(turns: RotorTurns, signals: np.ndarray, highest: int) -> np.ndarray:
    """Return the weighted means of x e^{-jhθ}, shape (highest + 1, m), complex.

    Line 0 is the mean over the angle; the others are of the signal without mean and slope.

    Parameters
    ----------
    turns : the turns.
    signals : ndarray, shape (n, m), real, of the samples of the turns.
    highest : h runs from 0 to it.
    """
    mean = turns.share @ signals
    centre = turns.window @ turns.theta
    arm = turns.theta - centre
    slope = (turns.window * arm) @ signals / ((turns.window * arm) @ arm)
    level = turns.window @ signals
    bins = np.floor(turns.theta * (BINS / TURN) + 0.5).astype(np.int64) % BINS
    folded = _folded(signals, bins, level, slope, arm, turns.window)
    found = np.fft.rfft(folded, axis=0)[:highest + 1]
    found[0] = mean
    return np.asarray(found)


@njit(cache=True, nogil=True)
def _folded(
    signals: np.ndarray, bins: np.ndarray, level: np.ndarray, slope: np.ndarray, arm: np.ndarray,
    window: np.ndarray,
) -> np.ndarray:
    """Return the weighted signals, without mean and slope, summed in bins, shape (BINS, m)."""
    found = np.zeros((BINS, signals.shape[1]))
    for i in range(signals.shape[0]):
        for m in range(signals.shape[1]):
            found[bins[i], m] += (signals[i, m] - level[m] - slope[m] * arm[i]) * window[i]
    return found


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
