"""What the plots show, computed from a record: folded currents, speed lines, torque."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ema_prognostics.features.turns import TURN, Turns, paper_window, whole_turns
from ema_prognostics.paper.envelope import fold
from ema_record.channels import (
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
)
from ema_record.errors import RecordError
from ema_record.record import Record

FOLD_BINS = 180
"""Bins of a turn, 2° each."""
MAX_ORDER = 12
"""Highest multiple of f_e in the spectrum."""


class Fold(NamedTuple):
    """The current of one phase against the rotor angle."""

    phase: str
    angle: np.ndarray
    """Of each sample, shape (n,) (°)."""
    current: np.ndarray
    """Shape (n,) (A)."""
    bins: np.ndarray
    """Middle of each bin, shape (m,) (°)."""
    mean_current: np.ndarray
    """Shape (m,) (A)."""
    mean_reference: np.ndarray
    """Shape (m,) (A)."""


def analysis_turns(record: Record) -> Turns | None:
    """Return the whole turns of the analysis window, None if the record has none."""
    try:
        return whole_turns(record, paper_window(record.profile))
    except RecordError:
        return None


def fold_currents(turns: Turns) -> list[Fold]:
    """Return the currents of phases a, b, c against the rotor angle."""
    angle = np.degrees(np.mod(turns.theta, TURN))
    bins = (np.arange(FOLD_BINS) + 0.5) * (360.0 / FOLD_BINS)
    currents = turns.samples[:, PHASE_CURRENTS]
    references = turns.samples[:, REFERENCE_CURRENTS]
    return [
        Fold(
            phase, angle, currents[:, k], bins, fold(turns, currents[:, k], FOLD_BINS),
            fold(turns, references[:, k], FOLD_BINS),
        )
        for k, phase in enumerate("abc")
    ]


def speed_spectrum(turns: Turns, max_order: int = MAX_ORDER) -> tuple[np.ndarray, np.ndarray]:
    """Return the amplitude of the motor speed at multiples of the rotor angle.

    The speed is demodulated against the measured angle over whole turns, so a multiple of
    f_e is exact whatever the speed, and no FFT grid is involved.

    Parameters
    ----------
    turns : Turns
        Whole turns of the rotor.
    max_order : int
        Highest multiple.

    Returns
    -------
    order : ndarray, shape (max_order * turns.count + 1,)
        Multiples of f_e, spaced by one over the number of turns.
    amplitude : ndarray, same shape
        Peak amplitude (rad/s), after mean and drift are taken out.

    """
    speed = turns.samples[:, MOTOR_SPEED]
    drift = np.linspace(-1.0, 1.0, len(speed))
    root = np.sqrt(turns.weight)
    base = np.stack([np.ones_like(drift), drift], axis=1)
    fit, *_ = np.linalg.lstsq(base * root[:, None], speed * root, rcond=None)
    weighted = turns.weight * (speed - base @ fit)
    order = np.arange(max_order * turns.count + 1) / turns.count
    # exp(-j n θ/count) by recurrence: one column at a time keeps the memory small.
    step = np.exp(-1j * turns.theta / turns.count)
    rotating = np.ones_like(step)
    amplitude = np.empty(len(order))
    for n in range(len(order)):
        amplitude[n] = 2.0 * abs(weighted @ rotating)
        rotating *= step
    return order, amplitude


def command_of(record: Record) -> np.ndarray:
    """Return the commanded surface position at each sample, shape (n,) (rad)."""
    return record.profile.command(record.time)


def torque_estimate(record: Record) -> np.ndarray:
    """Return the torque that the measured currents give with nominal constants.

    ``k Σ trapezoid(θ − φ_k) i_k``: what a healthy motor would have. Shape (n,) (N m).
    """
    from ema_record.actuator import load_actuator
    from ema_sim.plant.electrical import THIRD, unit_trapezoid

    motor = load_actuator().motor
    theta = record.channel("rotor_angle")
    torque = np.zeros(len(record))
    for k, phase in enumerate("abc"):
        shape = unit_trapezoid(theta - k * THIRD, motor.flat_top)
        torque += motor.back_emf_constant * shape * record.channel(f"phase_current_{phase}")
    return torque
