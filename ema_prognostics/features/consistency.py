"""Do the sensors agree with each other, and does anything unknown show: inputs of the guard."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ema_prognostics.features.signals import MIN_SAMPLES, Signals
from ema_record.channels import PHASE_CURRENTS, REFERENCE_CURRENTS


def _log(value: float) -> float:
    """Return the logarithm of a positive quantity, floored where it vanishes."""
    return float(np.log(max(value, 1e-9)))


def _detrended(x: np.ndarray, n: int) -> np.ndarray:
    """Return `x` less its running mean over `n` samples, ends left out."""
    mean = np.convolve(x, np.ones(n) / n, mode="valid")
    begin = n // 2
    return x[begin:begin + len(mean)] - mean


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
    samples = record.samples
    off = record.time < record.profile.inverter_off - 1e-3
    on = record.time > record.profile.command_time
    found: dict[str, float] = {}
    if np.count_nonzero(off) >= MIN_SAMPLES:
        found["noise_speed"] = _log(float(signals.speed[off].std()))
        found["noise_current"] = _log(float(samples[off][:, PHASE_CURRENTS].std(axis=0).max()))
        found["noise_current_least"] = _log(
            float(samples[off][:, PHASE_CURRENTS].std(axis=0).min())
        )
        start = record.profile.start
        if signals.has_position:
            found["start_position"] = 1e3 * float(signals.position[off].mean() - start)
    found["offset_largest"] = float(np.abs(signals.sensors.offset).max())
    gain = signals.sensors.gain - 1.0
    found["gain_largest"] = float(np.abs(gain).max())
    total = signals.currents[on].sum(axis=1)
    found["sum_rms"] = _log(float(total.std()))
    found["sum_mean"] = float(total.mean())
    if signals.has_references:
        references = samples[on][:, REFERENCE_CURRENTS]
        rms = (signals.currents[on] - references).std(axis=0)
        found["reference_rms"] = _log(float(rms.mean()))
        found["reference_spread"] = float((rms.max() - rms.min()) / max(rms.mean(), 1e-9))
        found["reference_sum"] = _log(float(references.sum(axis=1).std()))
    for name in [n for n in ("full", "quarter") if n in slews]:
        part = signals.between(*slews[name][:2])
        time = signals.time[part] - signals.time[part].mean()
        turning = float(time @ signals.motor_angle[part] / (time @ time))
        moving = float(time @ signals.position[part] / (time @ time))
        mean = float(signals.speed[part].mean())
        scale = max(abs(turning), 1.0)
        found[f"speed_over_angle_{name}"] = 1e3 * (mean - turning) / scale
        if signals.has_position:
            found[f"position_over_angle_{name}"] = 1e3 * (moving * ratio - turning) / scale
        residual = signals.position[part] - moving * time - signals.position[part].mean()
        if name == "quarter":
            if signals.has_position:
                found["position_rms_quarter"] = _log(float(residual.std()))
                change = np.abs(np.diff(signals.position[part]))
                found["position_step"] = 1e3 * float(np.quantile(change, 0.999))
            found["speed_rms_quarter"] = _log(float(_detrended(signals.speed[part], 41).std()))
            found["torque_rms_quarter"] = _log(
                float(_detrended(signals.torque_current[part], 41).std())
            )
            steps = np.abs(np.diff(signals.speed[part]))
            found["speed_step"] = _log(float(np.median(steps)) + 0.01)
    return found
