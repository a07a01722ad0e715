"""Reductions: what a campaign keeps of each record instead of its samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ema_record.channels import (
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
)
from ema_record.errors import UsageError
from ema_record.record import Record

Reduction = Callable[[Record], Any]
"""From a record to a number, an array, or a mapping of names to these; shapes must not vary."""

LINES = (1, 2, 3, 4, 6)
"""Multiples of the electrical frequency in the summary."""
SUMMARY_UNITS = {
    "duration": "s", "electrical_frequency": "Hz", "speed_mean": "rad/s", "speed_rms": "rad/s",
    "current_rms": "A", "torque_current_mean": "A", "position_end": "rad",
    **{f"speed_line_{h}": "rad/s" for h in LINES},
}
"""What `summary` gives, with units; lines are amplitudes (half of peak to peak)."""


def summary(record: Record) -> dict[str, float]:
    """Return a few numbers of a record, names and units as in `SUMMARY_UNITS`.

    Means and lines are taken over the whole electrical turns in the profile's analysis
    window (the whole record if it has none); lines refer to the rotor angle, so a speed that
    drifts does not smear them. Where there is no whole turn they are NaN.
    """
    found = dict.fromkeys(SUMMARY_UNITS, float("nan"))
    found["duration"] = record.duration
    found["position_end"] = float(record.samples[-1, SURFACE_POSITION])
    begin, end = record.profile.window or (0.0, np.inf)
    window = record.samples[(record.time >= begin) & (record.time < end)]
    if len(window) < 2 or not np.isfinite(window[:, ROTOR_ANGLE]).all():  # or not recorded
        return found
    angle = np.unwrap(window[:, ROTOR_ANGLE])
    forward = np.sign(angle[-1] - angle[0])
    travelled = forward * (angle - angle[0])
    turns = int(travelled[-1] // (2.0 * np.pi))
    if turns < 1:
        return found
    n = int(np.argmax(travelled >= 2.0 * np.pi * turns))
    speed, currents = window[:n, MOTOR_SPEED], window[:n, PHASE_CURRENTS]
    signs = np.sign(window[:n, REFERENCE_CURRENTS])
    found["electrical_frequency"] = turns * record.rate / n
    found["speed_mean"] = float(np.mean(speed))
    found["speed_rms"] = float(np.std(speed))
    found["current_rms"] = float(np.sqrt(np.mean(currents**2)))
    found["torque_current_mean"] = float(np.mean(np.sum(signs * currents, axis=1)) / 2.0)
    # Weighted by the angle travelled in each sample: the mean over the angle, not over time.
    steps = np.gradient(travelled[: n + 1])[:n]
    weighted = (speed - found["speed_mean"]) * steps / np.sum(steps)
    rotor = np.exp(-1j * angle[:n])
    power = np.ones(n, dtype=complex)
    for h in range(1, max(LINES) + 1):
        power = power * rotor
        if h in LINES:
            found[f"speed_line_{h}"] = float(2.0 * abs(np.sum(weighted * power)))
    return found


def reduction_name(reduction: Reduction) -> str:
    """Return the name by which a manifest knows a reduction."""
    module = getattr(reduction, "__module__", type(reduction).__module__)
    return f"{module}:{getattr(reduction, '__qualname__', type(reduction).__qualname__)}"


def as_columns(result: Any) -> dict[str, np.ndarray]:
    """Return what a reduction gave as named arrays of numbers.

    Raises
    ------
    UsageError
        It is neither numbers nor a mapping of names to numbers.
    """
    named = result if isinstance(result, Mapping) else {"result": result}
    columns = {}
    for name, value in named.items():
        array = np.asarray(value)
        if array.dtype.kind not in "biufcU":
            raise UsageError(
                f"the reduction gave {type(value).__name__} for {str(name)[:60]!r}: it must give "
                "numbers, arrays of numbers, or a mapping of names to these"
            )
        columns[str(name)] = array
    return columns
