"""How unequal the constants of the three phases are, from the torque lines of a slew.

A short or an eccentricity that stands still changes the constant of each phase by its own share,
k_c -> k_c (1 + e_c). What the torque current of equal phases leaves of the torque then has lines 2
and 4, ``m_h = Σ e_c p_hc``, with p_c the share of phase c in the torque current, its lines read
off the same record. Both lines are even: what the speed sensor makes up is not. What the three
have in common makes no line; the mean torque tells it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ema_prognostics.features.balance import Balance
from ema_prognostics.features.signals import THIRD, Signals
from ema_prognostics.features.turns import rotor_lines, whole_turns
from ema_sim.machine import unit_back_emf

LINES = (2.0, 4.0)
PLACES = [1, 3]
"""Of `LINES` in `line_orders`."""
ACROSS = np.array([[2.0, 0.0], [-1.0, np.sqrt(3.0)], [-1.0, -np.sqrt(3.0)]]) / np.sqrt(6.0)
"""Orthonormal, shape (3, 2): what sums to zero."""


def shares(signals: Signals, part: slice) -> np.ndarray:
    """Return what each phase gives of the torque current, shape (n, 3) (A)."""
    motor = signals.actuator.motor
    return np.column_stack([
        0.5 * unit_back_emf(signals.theta[part] - c * THIRD, motor) * signals.currents[part, c]
        for c in range(3)])


def deviations(
    signals: Signals, segments: Sequence[tuple[float, float, int]], balances: Sequence[Balance],
) -> np.ndarray:
    """Return e of each phase, shape (3,), of slews in both directions; their sum is zero."""
    start, pairs = signals.record.profile.command_time, signals.actuator.motor.pole_pairs
    made, seen, told = [], [], np.ones(len(PLACES), dtype=bool)
    for (begin, end, turns_least), balance in zip(segments, balances):
        turns = whole_turns(signals.record, (start + begin, start + end), min_turns=turns_least,
                            pole_pairs=pairs)
        first = int(np.searchsorted(signals.time, turns.samples[0, 0]))
        lines = rotor_lines(turns, shares(signals, slice(first, first + len(turns.theta))), LINES)
        made.append(lines[1:] / lines[0].sum().real)
        seen.append(balance.residual[PLACES])
        told &= balance.told[PLACES]
    if not told.any():
        return np.zeros(3)
    design = np.mean(made, axis=0)[told] @ ACROSS
    wanted = np.mean(seen, axis=0)[told]
    fit = np.linalg.lstsq(np.vstack([design.real, design.imag]),
                          np.concatenate([wanted.real, wanted.imag]), rcond=None)[0]
    return np.asarray(ACROSS @ fit)


def with_unequal_phases(signals: Signals, deviation: np.ndarray) -> Signals:
    """Return the signals with the torque current that phases of these constants make."""
    q = signals.torque_current + shares(signals, slice(None)) @ deviation
    return replace(signals, torque_current=q)
