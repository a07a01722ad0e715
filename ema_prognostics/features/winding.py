"""What voltages and currents tell of winding, supply and commutation sensor.

While two phases have not reached their references their legs stand still, one on each rail, so
the voltage between them is the whole bus, whatever the third phase and the neutral do::

    L d(i_j − i_k)/dt = V − R_j i_j + R_k i_k − k ω (τ_j − τ_k) − U (sgn i_j − sgn i_k)

That is so at the beginning of every commutation and whenever the actuator accelerates. Over all
such pairs of samples, least squares give 1/L and, each over L, the bus, R of each phase, k, the
drop U of the switches and the angle by which the commutation sensor is off (to first order the
back-EMF is then k ω (τ − δ τ')). The derivative carries the noise, so it is the side explained.

After a commutation the incoming phase rises at (V − e) / L until it meets its reference. The
charge that it lacks meanwhile is ½ I² L / (V − e): divided by I² it is a time over a current,
free of the load. Its growth from a quarter of the speed to the full speed shows the back-EMF,
its scatter between the phases a winding or a joint unlike the others.
"""

from __future__ import annotations

import numpy as np

from ema_prognostics.features.signals import Signals
from ema_record.channels import PHASE_CURRENTS, REFERENCE_CURRENTS, median
from ema_sim.machine import COPPER, FIRST_EDGE, REFERENCE, SECTOR, THIRD, unit_back_emf

MARGIN = 0.6
"""Of a current to the edge of the relay's band within which its leg may switch, of the band."""
LATENCY = 2.0
"""Control periods, beyond those declared, by which a reference may act later than recorded."""
TINY = 1e-9
DROP_CURRENT = 1.0
"""Current at which the drop of a switch counts as fully there, of the relay's band."""
STEP = 1e-3
"""Angle over which the slope of the trapezoid is taken (rad)."""
PRIOR = np.array([0.3] * 5 + [0.1] * 4)
"""Standard deviation of each unknown where nothing is measured, the drop of a switch of the bus
voltage: few pairs of samples say little, and then move little."""
NOMINAL = np.array([1.0] * 5 + [0.0] * 4)
ROUNDS = 8
LEAST_ERROR = 1e-3
"""Least size of the errors, of the bus voltage."""
PAIRS = ((0, 1), (1, 2), (2, 0))
PHASES = np.exp(-1j * THIRD * np.arange(3))
"""Weights that make one complex number of three phases; turns with them like a line 1."""
SPREAD_FLOOR = 0.02


def _references(signals: Signals, n: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return least and largest reference that may act on each leg, shape (n - 1,) each (A).

    The phases that carry it are those of the present rotor angle; how large it is may have been
    commanded up to `LATENCY` control periods ago.
    """
    acquisition, period = signals.actuator.acquisition, signals.actuator.control.period
    late = int(np.ceil((acquisition.reference_latency + LATENCY) * period * signals.rate))
    references = signals.record.samples[:n, REFERENCE_CURRENTS].T
    command = np.abs(references).max(axis=0)
    least, most = command.copy(), command.copy()
    for k in range(1, late + 1):
        least[k:] = np.minimum(least[k:], command[:-k])
        most[k:] = np.maximum(most[k:], command[:-k])
    found = []
    for reference in references:
        share = reference / np.maximum(command, TINY)
        one, other = share * least, share * most
        low, high = np.minimum(one, other), np.maximum(one, other)
        found.append((np.minimum(low[:-1], low[1:]), np.maximum(high[:-1], high[1:])))
    return found


def _saturated(signals: Signals, length: float) -> np.ndarray:
    """Return where each leg stands still from a sample to the next, shape (3, k), k < n.

    +1: on the upper rail, -1: on the lower, 0: not certain, such as while a change of the sector
    is recorded and does not act yet. `k` ends with `length`.
    """
    begin_time = signals.record.profile.inverter_off + 2.0 / signals.rate
    n = int(np.searchsorted(signals.time, signals.record.profile.command_time + length))
    band = signals.actuator.inverter.hysteresis
    margin = MARGIN * band
    theta = signals.theta[:n]
    place = (theta - FIRST_EDGE) / SECTOR
    reach, actuator = 0.5 * np.diff(place), signals.actuator
    late = actuator.acquisition.commutation_latency * actuator.control.period
    lag = actuator.motor.pole_pairs * signals.speed[:n - 1] * late / SECTOR
    sure = (np.floor(place[:-1] - reach - lag) == np.floor(place[1:] + reach)) & (
        signals.time[:n - 1] > begin_time)
    found = np.zeros((3, n - 1), dtype=np.int8)
    readings = signals.record.samples[:n, PHASE_CURRENTS].T
    for leg, reading, (low, high) in zip(found, readings, _references(signals, n)):
        half = 0.5 * np.diff(reading)
        begin, end = reading[:-1] - half, reading[1:] + half
        leg[sure & (begin < low - band - margin) & (end < low + band - margin)] = 1
        leg[sure & (begin > high + band + margin) & (end > high - band + margin)] = -1
    return found


def _equations(signals: Signals, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return L0 di/dt, shape (n,), and what explains it, shape (n, 9), of all pairs (V).

    Columns: bus, fall over each winding (3), back-EMF, drop of a volt, angle of a radian,
    inductances that differ (cosine and sine of `PHASES`).
    """
    actuator = signals.actuator
    motor = actuator.motor
    state = _saturated(signals, length)
    warm = signals.temperature - REFERENCE
    resistance = motor.phase_resistance * (1.0 + COPPER * warm)
    drop = DROP_CURRENT * actuator.inverter.hysteresis
    rows, sides = [], []
    for j, k in PAIRS:
        used = np.flatnonzero(state[j] * state[k] < 0)
        after = used + 1
        s = state[j, used].astype(float)
        before, then = signals.currents[used][:, [j, k]], signals.currents[after][:, [j, k]]
        middle = 0.5 * (then + before)
        sign = np.clip(middle / drop, -1.0, 1.0)
        rise = (then - before) / (signals.time[after] - signals.time[used])[:, None]
        fall = np.zeros((len(used), 3))
        fall[:, j] = -resistance * s * middle[:, 0]
        fall[:, k] = resistance * s * middle[:, 1]
        speed = 0.5 * (signals.speed[used] + signals.speed[after])
        shape = slope = 0.0
        for phase, part in ((j, 0.5), (k, -0.5)):
            for at in (used, after):
                angle = signals.theta[at] - phase * THIRD
                ahead = unit_back_emf(angle + STEP, motor)
                behind = unit_back_emf(angle - STEP, motor)
                shape = shape + part * 0.5 * (ahead + behind)
                slope = slope + part * (ahead - behind) / (2.0 * STEP)
        emf = 0.5 * signals.torque_constant * s * speed
        change = motor.phase_inductance * s[:, None] * rise * [1.0, -1.0]
        unlike = -change @ PHASES[[j, k]]
        rows.append(np.column_stack([
            np.full(len(used), signals.bus_voltage), fall, -emf * shape,
            -s * (sign[:, 0] - sign[:, 1]), emf * slope, unlike.real, unlike.imag,
        ]))
        sides.append(change.sum(axis=1))
    return np.concatenate(sides), np.vstack(rows)


def _fit(
    rows: np.ndarray, side: np.ndarray, least: float, prior: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the solution of rows x = side, and the error's size, freed of stray equations.

    `least`: least size of the errors (V); `prior`: standard deviation of each unknown about
    `NOMINAL`, shape (9,).

    A leg that switched unseen makes an equation wrong by some ten volts. Weights of Cauchy and
    the median of the errors leave such out (iteratively reweighted least squares).
    """
    found, scale = NOMINAL, 2.0 * least
    for _ in range(ROUNDS if len(side) else 0):
        error = np.abs(side - rows @ found)
        scale = max(1.5 * float(median(error)), least)
        root = 1.0 / np.sqrt(1.0 + (error / (2.0 * scale)) ** 2)
        known = np.diag(scale / prior)
        found = np.linalg.lstsq(np.vstack([rows * root[:, None], known]),
                                np.concatenate([side * root, known @ NOMINAL]), rcond=None)[0]
    return found, scale


def winding(signals: Signals, length: float) -> dict[str, float]:
    """Return logarithms of L, R and k over nominal, U (V), angle (mrad), errors.

    Nominal where the record has no pairs of samples to tell from. Lines 1: percent by which the
    phases differ. `length`: time after the first command that is used: all but the slow ramps (s).
    """
    side, rows = _equations(signals, length)
    bus = signals.actuator.inverter.bus_voltage
    prior = np.where(np.arange(9) == 5, bus * PRIOR, PRIOR)
    found, error = _fit(rows, side, LEAST_ERROR * bus, prior)
    gain = max(float(found[0]), 0.1)
    r = found[1:4] / gain
    resistance, inductance = complex(r @ PHASES), 1.5 * complex(*found[7:9])
    return {
        "winding_inductance": -float(np.log(gain)),
        "winding_resistance": float(np.log(max(r.mean(), 0.1))),
        "winding_back_emf": float(np.log(max(found[4] / gain, 0.1))),
        "switch_drop": float(found[5]) / gain,
        "sensor_angle": 1e3 * float(found[6]) / gain,
        "resistance_m1_re": 1e2 * resistance.real, "resistance_m1_im": 1e2 * resistance.imag,
        "inductance_m1_re": 1e2 * inductance.real, "inductance_m1_im": 1e2 * inductance.imag,
        "resistance_spread": float(np.log(abs(resistance) + SPREAD_FLOOR)),
        "inductance_spread": float(np.log(abs(inductance) + SPREAD_FLOOR)),
        "winding_error": float(np.log(error + 2.0 * LEAST_ERROR * bus)),
    }


def rise(signals: Signals, begin: float, end: float) -> tuple[float, float]:
    """Return the mean take-over and its spread between the phases, as logarithms.

    Parameters
    ----------
    signals : of the record.
    begin, end : a settled slew (s after the first command).
    """
    part = signals.between(begin, end)
    theta = signals.theta[part]
    ahead = theta[-1] >= theta[0]
    reference = signals.record.samples[part, REFERENCE_CURRENTS]
    lack = np.empty(3)
    for phase in range(3):
        angle = theta - phase * THIRD
        since = np.mod(angle - FIRST_EDGE if ahead else -FIRST_EDGE - angle, np.pi)
        incoming = since < SECTOR
        wanted = reference[incoming, phase]
        missing = np.abs(wanted) - np.sign(wanted) * signals.currents[part][incoming, phase]
        lack[phase] = missing.sum() / max(float(wanted @ wanted), TINY)
    mean = float(lack.mean())
    turned = complex(lack @ np.exp(1j * THIRD * np.arange(3)))
    return (float(np.log(max(mean, 1e-6))),
            float(np.log(abs(turned) / max(abs(mean), 1e-6) + 1e-3)))
