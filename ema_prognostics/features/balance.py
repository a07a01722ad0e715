"""The torque balance of the motor at each line, and the mean torque, of a segment.

The torque residual, in parts of the mean torque, with p pole pairs:
``m_h = (i J h p ω W_h − 2k q_h) / (2k q_0)``. What modulates the torque constants keeps its
residual when the actuator turns round; what the speed sensor makes up changes its sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ema_prognostics.features.signals import Signals, phase_shares
from ema_prognostics.features.turns import TURN, Turns, rotor_lines, waves_at, whole_turns
from ema_prognostics.features.vector import SWING
from ema_record.channels import TIME, median
from ema_record.errors import IncompleteRecordError

HARMONICS = 6
BINS = 360
BANDS = {"low": 12, "mid": 20, "top": 36}
"""Highest line of each band of those that no fault class excites; cogging, gear mesh and
saturation do."""
CELLS = 12
"""Parts of an electrical turn in which what is not of the rotor is looked for: up to line 6."""
LOWEST = 0.3
"""Least multiple of the electrical frequency of a limit cycle that is sought."""
ROUNDS = 20
"""Of reweighted least squares, which end at the least absolute deviations."""
LINE = 10.0
"""Multiple of the median line from which on one is a limit cycle's and no noise, of which a line
exceeds r times the median with the probability 2^(-r²)."""
WINDINGS = [1, 3]
"""Where lines 2 and 4 stand among `line_orders`."""
ZERO_SUM = np.array([[2.0, 0.0], [-1.0, np.sqrt(3.0)], [-1.0, -np.sqrt(3.0)]]) / np.sqrt(6.0)
"""Deviations of three phases that sum to zero, orthonormal, shape (3, 2)."""
DRIVEN = 0.01
"""Share of the torque of nominal friction below which the motor was driven from outside."""


def line_orders(pole_pairs: int) -> tuple[float, ...]:
    """Return the multiples of the electrical angle of lines 1 to 6.

    Even lines are those of the windings, 2, 4, 6. Odd ones are those of the rotor: once a turn
    of the rotor (its eccentricity as a whole, run-out of the speed sensor), and that beside lines
    2 and 4 (an eccentricity weighs the phases unlike). With one pole pair they are 1, 3, 5.
    """
    turn = 1.0 / pole_pairs
    return turn, 2.0, 2.0 + turn, 4.0, 4.0 + turn, 6.0


def other_orders(pole_pairs: int) -> np.ndarray:
    """Return the multiples of the electrical angle of all other lines.

    Up to the highest of `BANDS` they are those of a turn of the rotor: a gear wheel has so many
    teeth a turn. Up to line 6 the windings' multiples and those once a turn beside their even ones
    are left to the faults.
    """
    teeth = np.arange(1, max(BANDS.values()) * pole_pairs + 1)
    beside = np.minimum(teeth % (2 * pole_pairs), -teeth % (2 * pole_pairs))
    own = (teeth % pole_pairs == 0) | (beside == 1)
    return teeth[~own | (teeth > HARMONICS * pole_pairs)] / pole_pairs


class Balance(NamedTuple):
    """Torque balance of one segment."""

    residual: np.ndarray
    """m of the lines of `line_orders`, complex, shape (6,), in parts of the mean torque."""
    torque: float
    """Mean torque of the motor along its sense of rotation (N m)."""
    speed: float
    """Mean speed along the sense of rotation (rad/s)."""
    high: dict[str, float]
    """Largest |m_h| of the lines `other_orders`, in each of `BANDS`."""
    swing: float
    """Amplitude of what is in the speed beside the mean and no turn of the rotor repeats, in
    parts of the mean, of the median turn; 0 where that is noise or the rotor made but one."""
    told: np.ndarray
    """Which lines are measured, bool, shape (6,): those that no limit cycle falls onto."""


def _other_lines(
    turns: Turns, signal: np.ndarray, low: np.ndarray, pole_pairs: int
) -> np.ndarray:
    """Return the lines `other_orders` of what the low lines leave, complex, shape (n, m).

    Over whole turns the lines are orthogonal, so a projection serves; angles are taken in
    `BINS` parts of an electrical turn, which leaves 98 % of line 36.
    """
    bins = BINS * pole_pairs
    place = (turns.theta * (BINS / TURN)).astype(int) % bins
    mean = np.column_stack([
        np.bincount(place, turns.weight * column, minlength=bins) for column in signal.T])
    weight = np.bincount(place, turns.weight, minlength=bins)[:, None]
    angle = (np.arange(bins) + 0.5) * (TURN / BINS)
    known = np.exp(1j * np.outer(angle, line_orders(pole_pairs)))
    rest = mean - weight * (low[0].real + (known @ low[1:]).real)
    return 2.0 * np.exp(-1j * np.outer(other_orders(pole_pairs), angle)) @ rest


def _cells(turns: Turns, speed: np.ndarray, pole_pairs: int, arrival: float) -> np.ndarray:
    """Return what no turn of the rotor repeats of the speed, shape (turns, CELLS) (rad/s).

    Its lines are taken off sample by sample first: samples lie otherwise in a cell each turn. A
    drift and what is left of the way to the ramp, exp(-`arrival` t) (1/s) under a proportional
    position control, are no limit cycle: least absolute deviations, as a single jolt is neither.
    """
    orders = [k / pole_pairs for k in range(1, CELLS * pole_pairs + 1)]
    waves = np.array(list(waves_at(turns.theta, orders).values()))
    travelled = np.abs(turns.theta - turns.theta[0]) * (CELLS / TURN)
    cell = np.minimum(travelled.astype(int), CELLS * turns.count - 1)
    covered = np.maximum(np.bincount(cell, turns.weight, minlength=CELLS * turns.count), 1e-12)

    def beside(values: np.ndarray) -> np.ndarray:
        away = values - turns.weight @ values  # no matrix product below: it would wake all cores
        lines = 2.0 * np.einsum("hn,n->h", waves.conj(), turns.weight * away)
        away -= np.einsum("h,hn->n", lines, waves).real
        return np.bincount(cell, turns.weight * away, minlength=len(covered)) / covered

    time = turns.samples[:, TIME] - turns.samples[0, TIME]
    mean = beside(speed)
    slow = np.column_stack([
        np.ones(mean.size), beside(travelled), beside(np.exp(-arrival * time))])
    rest = mean
    for _ in range(ROUNDS):
        weight = 1.0 / np.sqrt(np.maximum(np.abs(rest), 1e-6))
        share = np.linalg.lstsq(slow * weight[:, None], mean * weight, rcond=None)[0]
        rest = mean - slow @ share
    revolutions = rest.reshape(turns.count // pole_pairs, -1)
    rest = revolutions - median(revolutions.T, axis=-1)
    return np.asarray(rest.reshape(turns.count, CELLS) * np.sqrt(
        len(revolutions) / max(len(revolutions) - 1.0, 1.0)))


def _without_cycle(
    turns: Turns, signal: np.ndarray, orders: Sequence[float], pole_pairs: int, arrival: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return a signal without what a limit cycle makes of it, see `Balance`.

    A slew may swing: static friction and a soft shaft make a limit cycle, whose frequency is not
    the rotor's. Its fundamental, sought where the speed is off the mean over the turns of the
    rotor, and its overtones are fitted together with the rotor's lines and taken off. A line that
    an overtone falls onto is not told from it. The signal has shape (n, m); after it: which lines
    are told, bool, shape (lines,), and `Balance.swing`.
    """
    speed, told = signal[:, 0], np.ones(len(orders), dtype=bool)
    rest = _cells(turns, speed, pole_pairs, arrival)
    length = 8 * rest.size
    power = np.abs(np.fft.rfft(rest.ravel() * np.hanning(rest.size), length))
    order = np.arange(len(power)) * (CELLS / length)
    sought = (order >= LOWEST) & (order <= HARMONICS)
    power, order = power[sought], order[sought]
    if power.max() <= LINE * median(power):
        return signal, told, 0.0
    # The median turn: a single jolt is no limit cycle.
    swing = float(np.sqrt(2.0 * median((rest**2).mean(axis=1))) / abs(turns.weight @ speed))
    if swing <= SWING:
        return signal, told, swing
    time = turns.samples[:, TIME] - turns.samples[0, TIME]
    away = turns.weight * (speed - turns.weight @ speed)

    def lower(order: float) -> float:
        return -abs(complex(away @ np.exp(-1j * TURN * turns.frequency * order * time)))

    from scipy.optimize import minimize_scalar  # not for steady records: `ema check` is quick

    found, half = float(order[np.argmax(power)]), 1.0 / turns.count
    found = float(minimize_scalar(lower, bounds=(found - half, found + half),
                                  method="bounded").x)
    columns = []
    for k in range(1, int(HARMONICS / found) + 1):
        near = np.abs(np.asarray(orders) - k * found) < half
        told &= ~near
        if not near.any():
            wave = np.exp(1j * TURN * turns.frequency * k * found * time)
            columns += [wave.real, wave.imag]
    if not columns:
        return signal, told, swing
    waves = np.exp(1j * np.outer(orders, turns.theta))
    drift = np.linspace(-1.0, 1.0, len(time))
    design = np.vstack([columns, np.ones_like(drift), drift, waves.real, waves.imag])
    weighted = design * turns.weight
    fit = np.linalg.lstsq(weighted @ design.T, weighted @ signal, rcond=None)[0]
    return signal - np.array(columns).T @ fit[:len(columns)], told, swing


def _turns(signals: Signals, begin: float, end: float, min_turns: int) -> tuple[Turns, slice]:
    """Return the whole turns between two times after the first command (s), and their samples."""
    t0 = signals.record.profile.command_time
    turns = whole_turns(signals.record, (t0 + begin, t0 + end), min_turns=min_turns,
                        pole_pairs=signals.actuator.motor.pole_pairs)
    first = int(np.searchsorted(signals.time, turns.samples[0, 0]))
    return turns, slice(first, first + len(turns.theta))


def torque_balance(signals: Signals, begin: float, end: float, min_turns: int) -> Balance:
    """Return the balance between two times after the first command (s).

    Raises
    ------
    IncompleteRecordError
        The motor did not turn, or was driven from outside.
    """
    motor = signals.actuator.motor
    turns, part = _turns(signals, begin, end, min_turns)
    pairs = motor.pole_pairs
    # All segments count the electrical turns of one of the rotor from the record's first.
    before = round((signals.theta[part.start] - turns.theta[0]) / TURN) % pairs
    turns = replace(turns, theta=turns.theta + TURN * before)
    signal = np.column_stack([signals.speed[part], signals.torque_current[part]])
    orders = line_orders(pairs)
    arrival = signals.actuator.control.position_gain / signals.actuator.gear.ratio
    signal, told, swing = _without_cycle(turns, signal, orders, pairs, arrival)
    lines = rotor_lines(turns, signal, orders)
    lines = np.vstack([lines, _other_lines(turns, signal, lines, pairs)])
    h = np.concatenate([orders, other_orders(pairs)])
    k2 = signals.torque_constant
    mean_speed, mean = lines[0, 0].real, lines[0, 1].real
    if turns.direction * mean * k2 <= DRIVEN * signals.actuator.friction_torque:
        raise IncompleteRecordError(
            f"mean torque current {mean:.3g} A against the sense of rotation: the motor was "
            "driven from outside: repeat the test without load; if all records say so, signs "
            "or order of the currents or the zero of the rotor angle are not as docs/api.md asks"
        )
    turning = pairs * mean_speed  # electrical: the lines are those of `theta`
    residual = (1j * motor.inertia * h * turning * lines[1:, 0] - k2 * lines[1:, 1]) / (k2 * mean)
    largest, least = {}, 0
    for band, most in BANDS.items():
        inside = (h[HARMONICS:] > least) & (h[HARMONICS:] <= most)
        largest[band], least = float(np.abs(residual[HARMONICS:][inside]).max()), most
    return Balance(
        residual[:HARMONICS], float(k2 * abs(mean)), float(abs(mean_speed)), largest,
        swing, told)


def with_own_constants(
    signals: Signals, slews: Sequence[tuple[float, float, int]], balances: Sequence[Balance]
) -> Signals:
    """Return signals whose torque current has each phase by the constant that it has itself.

    A short or an eccentricity that stands still changes the constants, k_c -> k_c (1 + e_c). What
    the torque current of equal phases leaves of the torque then has lines 2 and 4,
    ``m_h = Σ e_c p_hc``, with p_c the share of phase c in the mean torque current. Both are even:
    what the speed sensor makes up is not. What the phases have in common makes no line.

    Parameters
    ----------
    slews : begin, end (s) and least turns of slews in both directions.
    balances : of these.
    """
    shares = phase_shares(signals.theta, signals.currents, signals.actuator.motor)
    told = np.logical_and.reduce([balance.told for balance in balances])[WINDINGS]
    if not told.any():
        return signals
    made = []
    for slew in slews:
        turns, part = _turns(signals, *slew)
        lines = rotor_lines(turns, shares[part], (2.0, 4.0))
        made.append(lines[1:] / lines[0].sum().real)
    design = np.mean(made, axis=0)[told] @ ZERO_SUM
    wanted = np.mean([balance.residual[WINDINGS] for balance in balances], axis=0)[told]
    fit = np.linalg.lstsq(np.vstack([design.real, design.imag]),
                          np.concatenate([wanted.real, wanted.imag]), rcond=None)[0]
    return replace(signals, torque_current=signals.torque_current + shares @ (ZERO_SUM @ fit))
