"""Do the sensors agree with each other, and does anything unknown show: inputs of the guard.

What measures the recorder and not the machine (noise, rounding, sums that should vanish) has a
floor: below a part of what the actuator's description declares all records are alike, so none is
suspicious for being quieter, finer or exactly zero.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ema_prognostics.features.signals import MIN_SAMPLES, Signals
from ema_record.actuator import Actuator
from ema_record.channels import PHASE_CURRENTS, REFERENCE_CURRENTS, median

QUIET = 0.25
"""Part of the declared noise below which all records are alike."""
TINY = 1e-9
"""Floor where nothing is declared, in the unit of the channel."""
SMOOTHING = 41
"""Samples of the running mean that is taken off before a scatter is measured."""
PARTS, PART_SAMPLES = 8, 16
"""Into so many parts an interval at rest is cut at most, of at least so many samples, to tell
noise from motion."""


def _log(value: float, floor: float = 0.0) -> float:
    """Return the logarithm of a positive quantity, floored where it vanishes."""
    return float(np.log(max(value, floor, TINY)))


def scatter_at_rest(values: np.ndarray) -> np.ndarray:
    """Return the noise of values, shape (n, m) -> (m,): rms about a line, of the middle part.

    Of some parts of the interval: a shaft that unwinds as the drive lets go is motion. The median
    of the parts, as a feature must hold where one part moves; an identification, which removes a
    parabola, takes the mean square of all, as it asks how large the noise of the test was.
    """
    found = []
    for part in np.array_split(values, max(1, min(PARTS, len(values) // PART_SAMPLES))):
        time = np.arange(len(part)) - 0.5 * (len(part) - 1)
        rest = part - part.mean(axis=0) - np.outer(time, time @ part / (time @ time))
        found.append(np.sqrt((rest**2).sum(axis=0) / (len(part) - 2)))
    return np.asarray(median(np.transpose(found), axis=-1))


def detrended(x: np.ndarray) -> np.ndarray:
    """Return `x` less its running mean, shape (len(x) - SMOOTHING + 1,)."""
    n = SMOOTHING
    total = np.concatenate([[0.0], np.cumsum(x - x[0])])
    begin = n // 2
    mean = (total[n:] - total[:-n]) / n
    return x[begin:begin + len(mean)] - x[0] - mean


def resolution(x: np.ndarray) -> float:
    """Return the smallest difference between two readings that differ, 0 of a constant.

    That is the step of a converter, whatever the noise; of readings that were not rounded it is
    next to nothing.
    """
    steps = np.diff(np.sort(x))
    different = steps[steps > TINY * max(float(np.abs(x).max(initial=0.0)), TINY)]
    return float(different.min()) if len(different) else 0.0


def floors(actuator: Actuator, rate: float) -> dict[str, float]:
    """Return what readings may be quieter and finer than: of current (A), speed, position.

    Parameters
    ----------
    actuator : its declared noise and converters.
    rate : samples a second.

    Returns
    -------
    ``current``, ``speed`` and ``position``, parts of the noise of a sample; ``sum``, of three
    currents; ``speed_step`` and ``position_step``, the steps of the declared converters if these
    are larger. SI units.
    """
    noise, c = actuator.sample_noise(rate), actuator.converters
    rounds = actuator.acquisition.converters
    speed, current, position = (
        QUIET * least for least in (noise.speed, noise.current, noise.position))
    return {
        "current": current, "sum": float(np.sqrt(3.0)) * current,
        "speed": speed, "position": position,
        "speed_step": max(speed, rounds * c.speed_range / 2.0**c.speed_bits),
        "position_step": max(position, rounds * c.position_range / 2.0**c.position_bits),
    }


def consistency(
    signals: Signals, slews: Mapping[str, tuple[float, float, int]]
) -> dict[str, float]:
    """Return what relates the channels to each other, by name.

    Parameters
    ----------
    signals : of the record.
    slews : begin and end (s after the first command) of ``full`` and maybe of ``quarter``.
    """
    record, ratio = signals.record, signals.actuator.gear.ratio
    least = floors(signals.actuator, signals.rate)
    off = record.at_rest
    on = slice(int(np.searchsorted(signals.time, record.profile.command_time, side="right")), None)
    found: dict[str, float] = {}
    if off.stop - off.start >= MIN_SAMPLES:
        quiet = scatter_at_rest(record.samples[off, PHASE_CURRENTS])
        found["noise_speed"] = _log(
            float(scatter_at_rest(signals.speed[off, None])[0]), least["speed"])
        found["noise_current"] = _log(float(quiet.max()), least["current"])
        found["noise_current_least"] = _log(float(quiet.min()), least["current"])
        start = record.profile.start
        if signals.has_position:
            found["start_position"] = 1e3 * float(signals.position[off].mean() - start)
    found["offset_largest"] = float(np.abs(signals.sensors.offset).max())
    gain = signals.sensors.gain - 1.0
    found["gain_largest"] = float(np.abs(gain).max())
    # One phase after the other: a column of a table is read at a third of the cost of a row sum.
    currents = [signals.currents[on, k] for k in range(3)]
    references = [record.samples[on, REFERENCE_CURRENTS.start + k] for k in range(3)]
    total = currents[0] + currents[1] + currents[2]
    found["sum_rms"] = _log(float(total.std()), least["sum"])
    found["sum_mean"] = float(total.mean())
    if signals.has_references:
        rms = np.array([(i - r).std() for i, r in zip(currents, references)])
        found["reference_rms"] = _log(float(rms.mean()))
        found["reference_spread"] = float((rms.max() - rms.min()) / max(rms.mean(), TINY))
        found["reference_sum"] = _log(
            float((references[0] + references[1] + references[2]).std()), least["sum"])
    for name in [n for n in ("full", "quarter") if n in slews]:
        part = signals.between(*slews[name][:2])
        time = signals.time[part] - signals.time[part].mean()
        turning = float(time @ signals.motor_angle[part] / (time @ time))
        moving = float(time @ signals.position[part] / (time @ time))
        speed, angle = signals.speed[part], signals.motor_angle[part]
        # Between the same two readings: a line through all would weigh the middle, and a motor
        # that still gains speed would be off its own angle.
        turned = float(angle[-1] - angle[0]) / float(time[-1] - time[0])
        mean = float(np.trapezoid(speed, time)) / float(time[-1] - time[0])
        if name == "full":
            if signals.has_position:
                found["position_step"] = _log(
                    resolution(signals.position[part]), least["position_step"])
            found["speed_step"] = _log(resolution(signals.speed[part]), least["speed_step"])
        scale = max(abs(turning), 1.0)
        found[f"speed_over_angle_{name}"] = 1e3 * (mean - turned) / scale
        if signals.has_position:
            found[f"position_over_angle_{name}"] = 1e3 * (moving * ratio - turning) / scale
        residual = signals.position[part] - moving * time - signals.position[part].mean()
        if name == "quarter":
            if signals.has_position:
                found["position_rms_quarter"] = _log(float(residual.std()), least["position"])
            found["speed_rms_quarter"] = _log(
                float(detrended(signals.speed[part]).std()), least["speed"])
            found["torque_rms_quarter"] = _log(
                float(detrended(signals.torque_current[part]).std()), least["current"])
    return found
