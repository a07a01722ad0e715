"""A record as numbers, for the scorer's own gap: plain means, no model and no workflow.

Blocks are named ``segment k: signal``: one curve over time, or one line in rotor angle
(``line 2``: twice an electrical turn; cosine and sine).
"""

from __future__ import annotations

import numpy as np

from ema_record.actuator import load_actuator
from ema_record.channels import MOTOR_SPEED, PHASE_CURRENTS, REFERENCE_CURRENTS
from ema_record.profile import Profile
from ema_record.record import Record

ANGLE_BINS, TIME_BINS, LINES = 72, 40, 30
SHORTEST = 0.03
"""A segment that is shorter joins the next (s)."""
SETTLING = 0.06
"""Left out of the lines at the begin of a segment (s): its transient is not periodic."""
STEADY = 0.2
"""And where the speed is farther than this share from the segment's median."""


def segments(profile: Profile) -> list[tuple[float, float]]:
    """Return the intervals between the corners of the command (s)."""
    corners = [profile.inverter_off]
    for time, _ in profile.points:
        if time - corners[-1] >= SHORTEST:
            corners.append(time)
    corners[-1] = profile.duration
    return list(zip(corners, corners[1:]))


def _unit_trapezoid(theta: np.ndarray) -> np.ndarray:
    """Return the unit back-EMF of phase a, flat over 120°, centred at 90°."""
    return np.asarray(np.clip(6.0 / np.pi * np.arcsin(np.sin(theta)), -1.0, 1.0))


def _means(x: np.ndarray, bins: np.ndarray, n: int) -> np.ndarray:
    """Return the means of `x` in `n` bins; the mean of all in an empty one."""
    count = np.bincount(bins, minlength=n)
    total = np.bincount(bins, weights=x, minlength=n)
    return np.where(count > 0, total / np.maximum(count, 1), x.mean())


def _steady(speed: np.ndarray, time: np.ndarray, rate: float) -> np.ndarray:
    """Return where a segment is settled at its median speed; all of it where nothing is."""
    width = max(1, round(0.005 * rate))
    smooth = np.convolve(speed, np.full(width, 1.0 / width), mode="same")
    usual = np.median(smooth[time > SETTLING]) if np.any(time > SETTLING) else 0.0
    found = (time > SETTLING) & (np.abs(smooth - usual) <= STEADY * abs(usual))
    return found if found.sum() > ANGLE_BINS else np.ones_like(found)


def _lines(x: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return cosine and sine of the lines 1 to `LINES` a turn, shape (lines, 2)."""
    folded = _means(x, angles, ANGLE_BINS)
    spectrum = np.fft.rfft(folded)[1:LINES + 1] / (0.5 * ANGLE_BINS)
    return np.stack([spectrum.real, spectrum.imag], axis=1)


def view(record: Record) -> dict[str, np.ndarray]:
    """Return the blocks of a record of the present kit's actuator."""
    actuator = load_actuator()
    pairs, ratio = actuator.motor.pole_pairs, actuator.gear.ratio
    x, t = record.samples, record.time
    theta, position = record.channel("rotor_angle"), record.channel("surface_position")
    speed = x[:, MOTOR_SPEED]
    travel = np.unwrap(theta) / pairs
    shape = np.stack([_unit_trapezoid(theta - k * 2.0 * np.pi / 3.0) for k in range(3)], axis=1)
    torque_current = 0.5 * np.sum(shape * x[:, PHASE_CURRENTS], axis=1)
    demanded = 0.5 * np.sum(shape * x[:, REFERENCE_CURRENTS], axis=1)
    error = x[:, PHASE_CURRENTS] - x[:, REFERENCE_CURRENTS]
    total = x[:, PHASE_CURRENTS].sum(axis=1)
    off = t < record.profile.inverter_off
    found = {"inverter off: currents": x[off, PHASE_CURRENTS].mean(axis=0),
             "inverter off: position": position[off].mean(keepdims=True)}
    for number, (start, end) in enumerate(segments(record.profile)):
        inside = (t >= start) & (t < end)
        times = np.minimum(
            ((t[inside] - start) / (end - start) * TIME_BINS).astype(int), TIME_BINS - 1)
        angles = np.minimum(
            (theta[inside] / (2.0 * np.pi) % 1.0 * ANGLE_BINS).astype(int), ANGLE_BINS - 1)
        w = speed[inside]
        twist = (travel[inside] - travel[inside][0]) / ratio - position[inside]
        over_time = {
            "speed": w, "position": position[inside], "torque current": torque_current[inside],
            "demanded current": demanded[inside], "motor travel less position": twist,
            "travel less integral of speed":
                travel[inside] - travel[inside][0] - np.cumsum(w) / record.rate,
        }
        for name, signal in over_time.items():
            found[f"segment {number}: {name}"] = _means(signal, times, TIME_BINS)
        steady = _steady(w, t[inside] - start, record.rate)
        for name, signals in {
            "torque current": torque_current[inside][:, None],
            "demanded current": demanded[inside][:, None], "speed": w[:, None],
            "current error": error[inside], "current sum": total[inside][:, None],
        }.items():
            lines = np.hstack(
                [_lines(signal[steady], angles[steady]) for signal in signals.T])
            for order, line in enumerate(lines, start=1):
                found[f"segment {number}: {name}, line {order}"] = line
    return found
