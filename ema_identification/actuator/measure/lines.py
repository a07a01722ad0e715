"""Lines of signals in rotor angle.

They are complex amplitudes against the rotor angle, seen through a Hann window in angle: it keeps
drift and decaying transients out, so that they do not depend on the angle at which a segment
begins.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numba import njit

from ema_record.actuator import Actuator
from ema_sim.machine import TURN


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
    folded, mean = _folded(np.ascontiguousarray(signals.T), turns.theta, turns.share, turns.window)
    found = np.fft.rfft(folded)[:, :highest + 1].T
    found[0] = mean
    return np.asarray(found)


@njit(cache=True, error_model="numpy", nogil=True)
def _folded(
    signals: np.ndarray, theta: np.ndarray, share: np.ndarray, window: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the windowed signals, without mean and slope, summed in bins, (m, BINS); means, (m,).

    `signals` : shape (m, n). Mean and slope are taken off the bins.
    """
    m, n = signals.shape
    found, mean = np.zeros((m, BINS)), np.empty(m)
    weight, arm = np.zeros(BINS), np.zeros(BINS)
    place, part = np.empty(n, dtype=np.int64), np.empty(n)
    first = square = 0.0
    for i in range(n):
        bin_ = int(np.floor(theta[i] * (BINS / TURN) + 0.5)) % BINS
        beyond = theta[i] - theta[0]
        place[i], part[i] = bin_, window[i] * beyond
        weight[bin_] += window[i]
        arm[bin_] += part[i]
        first += part[i]
        square += part[i] * beyond
    for k in range(m):
        level = tilt = whole = 0.0
        for i in range(n):
            x = signals[k, i]
            whole += share[i] * x
            level += window[i] * x
            tilt += part[i] * x
            found[k, place[i]] += window[i] * x
        mean[k] = whole
        slope = (tilt - first * level) / (square - first * first)
        for b in range(BINS):
            found[k, b] -= level * weight[b] + slope * (arm[b] - first * weight[b])
    return found, mean


def rotor_lines(
    theta: np.ndarray, current: np.ndarray, speed: np.ndarray, part: slice, actuator: Actuator
) -> Iterator[tuple[dict[str, tuple[str, str]], list[float]]]:
    """Yield signal and abscissa by key, and values, of each line that is not an electrical one.

    Eccentricity and run-out come once a turn and beside the windings' even lines (as
    `ema_prognostics.features.balance` has them), the teeth of a wheel at any whole number.
    """
    pairs = actuator.motor.pole_pairs
    orders = [h for h in (*range(1, 2 * pairs + 2), 4 * pairs - 1, 4 * pairs + 1) if h % pairs]
    turns = turns_of(theta / pairs, part)
    if turns is None:
        found = np.zeros((4 * pairs + 2, 2), dtype=complex)
    else:
        stack = np.column_stack([current[turns.part], speed[turns.part]])
        found = lines(turns, stack, 4 * pairs + 1)
    accelerating = 1j * np.arange(len(found)) * actuator.motor.inertia * found[0, 1].real
    torque = 2.0 * actuator.motor.back_emf_constant * found[:, 0] - accelerating * found[:, 1]
    for h in orders:
        for half, of in (("re", np.real), ("im", np.imag)):
            yield {f"turn_torque_line_{h}_{half}": ("motor torque", "rotor angle"),
                   f"turn_speed_line_{h}_{half}": ("motor speed", "rotor angle")}, [
                1e3 * float(of(torque[h])), float(of(found[h, 1]))]
