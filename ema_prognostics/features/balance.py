"""The torque balance of the motor at each line, and the mean torque, of a segment.

The torque residual, in parts of the mean torque, with p pole pairs:
``m_h = (i J h p ω W_h − 2k q_h) / (2k q_0)``. What modulates the torque constants keeps its
residual when the actuator turns round; what the speed sensor makes up changes its sign.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ema_prognostics.features.signals import Signals
from ema_prognostics.features.turns import TURN, Turns, rotor_lines, whole_turns
from ema_record.errors import IncompleteRecordError

HARMONICS = 6
BINS = 360
HIGH = tuple(range(7, 37))
"""Lines that no fault class excites; cogging, gear mesh and saturation do."""


class Balance(NamedTuple):
    """Torque balance of one segment."""

    residual: np.ndarray
    """m_1..m_6, complex, shape (6,), in parts of the mean torque."""
    torque: float
    """Mean torque of the motor along its sense of rotation (N m)."""
    speed: float
    """Mean speed along the sense of rotation (rad/s)."""
    high: np.ndarray
    """|m_h| of the lines `HIGH`, shape (30,)."""


def _high_lines(turns: Turns, signal: np.ndarray, low: np.ndarray) -> np.ndarray:
    """Return the lines `HIGH` of what the low lines leave, complex, shape (30, m).

    Over whole turns the lines are orthogonal, so a projection serves; angles are taken in
    `BINS` parts of a turn, which leaves 98 % of line 36.
    """
    place = (turns.theta * (BINS / TURN)).astype(int) % BINS
    mean = np.column_stack([
        np.bincount(place, turns.weight * column, minlength=BINS) for column in signal.T])
    weight = np.bincount(place, turns.weight, minlength=BINS)[:, None]
    angle = (np.arange(BINS) + 0.5) * (TURN / BINS)
    powers = np.exp(-1j * np.outer(np.arange(1, HIGH[-1] + 1), angle))
    rest = mean - weight * (low[0].real + (powers[:HARMONICS].conj().T @ low[1:]).real)
    return 2.0 * powers[HARMONICS:] @ rest


def torque_balance(
    signals: Signals, begin: float, end: float, min_turns: int, *, high: bool = False
) -> Balance:
    """Return the balance between two times after the first command (s).

    Raises
    ------
    IncompleteRecordError
        The motor did not turn, or was driven from outside.
    """
    t0 = signals.record.profile.command_time
    turns = whole_turns(signals.record, (t0 + begin, t0 + end), min_turns=min_turns)
    first = int(np.searchsorted(signals.time, turns.samples[0, 0]))
    part = slice(first, first + len(turns.theta))
    signal = np.column_stack([signals.speed[part], signals.torque_current[part]])
    lines = rotor_lines(turns, signal, HARMONICS)
    if high:
        lines = np.vstack([lines, _high_lines(turns, signal, lines)])
    top = len(lines) - 1
    mean_speed, mean = lines[0, 0].real, lines[0, 1].real
    if turns.direction * mean <= 0.05:
        raise IncompleteRecordError(
            f"mean torque current {mean:.3g} A against the sense of rotation: the motor was "
            "driven from outside, repeat the test without load"
        )
    h = np.arange(1, top + 1)
    k2 = signals.torque_constant
    motor = signals.actuator.motor
    turning = motor.pole_pairs * mean_speed  # electrical: the lines are those of `theta`
    residual = (1j * motor.inertia * h * turning * lines[1:, 0] - k2 * lines[1:, 1]) / (k2 * mean)
    return Balance(
        residual[:HARMONICS], float(k2 * abs(mean)), float(abs(mean_speed)),
        np.abs(residual[HARMONICS:]),
    )
