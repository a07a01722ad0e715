"""The inputs of the cascade that has a healthy class: torque lines and mechanics of a test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_prognostics.current_sensors import current_sensors
from ema_prognostics.segments import SEGMENTS, ProfileKind
from ema_prognostics.start_stiffness import start_stiffness
from ema_prognostics.torque_lines import HARMONICS, Plant, torque_lines
from ema_prognostics.transmission import (
    START_LENGTH,
    mean_between,
    peak_after,
    rise_time,
    transmission_lag,
)
from ema_prognostics.turns import whole_turns
from ema_record.channels import PHASE_CURRENTS, TIME
from ema_record.record import Record

MECHANICS: dict[ProfileKind, tuple[str, ...]] = {
    "step": (
        "log_current_full", "rise_time", "lag_at_rest", "lag_peak", "start_stiffness_1",
        "start_stiffness_2",
    ),
    "extended": (
        "log_current_full", "log_current_full_back", "log_current_quarter",
        "log_current_quarter_back", "rise_time", "lag_reversal_full", "lag_reversal_quarter",
        "lag_reversal_ramp",
    ),
}
"""Names of the mechanical features of each kind.

log_current_*: log of the mean torque current of a segment (log A). rise_time: from the command
to 90 % of the speed (ms). lag_at_rest, lag_peak: lag of the surface before the start and at its
peak, less that of the slew (mrad). start_stiffness_*: relative, see `start_stiffness`.
lag_reversal_*: lag forward less lag back (mrad).
"""
WORDS = {
    "log_current_full": "torque current at full speed",
    "log_current_full_back": "torque current at full speed back",
    "log_current_quarter": "torque current at a quarter of the speed",
    "log_current_quarter_back": "torque current at a quarter of the speed back",
    "rise_time": "time to full speed",
    "lag_at_rest": "wind-up between rest and slew",
    "lag_peak": "peak of the wind-up at the start",
    "start_stiffness_1": "stiffness behind the motor when it starts",
    "start_stiffness_2": "stiffness behind the motor after its first 0.25 rad",
    "lag_reversal_full": "wind-up and lost motion between the full slews",
    "lag_reversal_quarter": "wind-up and lost motion between the quarter-speed slews",
    "lag_reversal_ramp": "wind-up and lost motion between the ramps",
}
"""What a feature is, for a person."""
RAMPS = ((2.348, 2.498), (2.858, 3.008))
"""Slow ramps of the extended test, forward and back, after the command (s)."""
LAST_TIME: dict[ProfileKind, float] = {"step": 0.36, "extended": 3.008}
"""What a record must cover at least, after the command (s)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CascadeFeatures:
    """Features of one record.

    Attributes
    ----------
    lines : ndarray, complex, shape (segments, 6). Torque residual m_1..m_6 a segment.
    mechanics : ndarray, shape (len(MECHANICS[kind]),).
    """

    lines: np.ndarray
    mechanics: np.ndarray


def cascade_features(record: Record, kind: ProfileKind, plant: Plant) -> CascadeFeatures:
    """Return the features of `record`; raises RecordError where they cannot be had."""
    command = record.profile.command_time
    sensors = current_sensors(record)
    lines = np.empty((len(SEGMENTS[kind]), HARMONICS), dtype=complex)
    current, direction, speed = {}, 1, 0.0
    for index, segment in enumerate(SEGMENTS[kind]):
        window = (command + segment.begin, command + segment.end)
        turns = whole_turns(record, window, min_turns=segment.min_turns)
        found = torque_lines(
            turns, sensors.correct(turns.samples[:, PHASE_CURRENTS]), plant
        )
        lines[index] = found.residual
        current[segment.name] = np.log(found.mean_current)
        if index == 0:
            direction, speed = turns.direction, found.speed
    lag = direction * transmission_lag(record, plant.gear_ratio)
    means = {
        s.name: mean_between(record, lag, command + s.begin, command + s.end)
        for s in SEGMENTS[kind]
    }
    values = {
        **{f"log_current_{name}": value for name, value in current.items()},
        "rise_time": 1e3 * rise_time(record, command, speed),
        "lag_peak": 1e3 * (peak_after(record, lag, command, START_LENGTH) - means["full"]),
        "lag_at_rest": 1e3
        * (mean_between(record, lag, float(record.samples[0, TIME]), command) - means["full"]),
    }
    if kind == "step":
        stiffness = start_stiffness(record, sensors, plant)
        values["start_stiffness_1"], values["start_stiffness_2"] = map(float, stiffness)
    else:
        for name in ("full", "quarter"):
            values[f"lag_reversal_{name}"] = 1e3 * (means[name] - means[f"{name}_back"])
        forward, back = (
            mean_between(record, lag, command + begin, command + end) for begin, end in RAMPS
        )
        values["lag_reversal_ramp"] = 1e3 * (forward - back)
    return CascadeFeatures(
        lines=lines, mechanics=np.array([values[name] for name in MECHANICS[kind]])
    )
