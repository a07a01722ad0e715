"""Features of the guard that belong together: one part of the physics, measured several ways.

A change that moves several features of one part a little shows in their common distance long
before any of them, or the distance of all hundred features, is unusual.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

FEWEST = 2
"""Features that make a group."""

GROUPS: dict[str, tuple[str, ...]] = {
    "transmission": ("shaft_", "stiffness_agreement", "compliance", "lag_", "gap_load",
                     "gap_error", "torque_ramp", "torque_quarter_over_ramp", "start_stiffness"),
    "commutation": ("sensor_angle", "quarter_even_m6", "quarter_odd_m6", "full_even_m6",
                    "full_odd_m6", "high_low"),
    "speed_sensor": ("quarter_odd_m1", "full_odd_m1", "quarter_odd_m2", "full_odd_m2",
                     "inertia_error"),
    "motor_constant": ("winding_back_emf", "rise_full", "rise_quarter", "viscous_torque",
                       "torque_full", "inertia", "winding_resistance", "winding_inductance",
                       "switch_drop"),
    "acceleration": ("inertia", "rise_time"),
    "vibration": ("high_", "speed_rms", "torque_rms", "gap_load", "gap_error"),
}
"""Beginnings of the features' names.

By physics, not by what a stranger moves. Differences between the windings make no group: a
short moves them itself, and the drivers do not tell how much."""


@lru_cache(maxsize=16)
def group_columns(checked: tuple[str, ...]) -> Mapping[str, np.ndarray]:
    """Return where the features of each group stand among the `checked` ones.

    Kept, since a model asks it of the same features for each of its limits.
    """
    found = {
        name: np.array([k for k, n in enumerate(checked) if n.startswith(group)])
        for name, group in GROUPS.items()
    }
    return {name: columns for name, columns in found.items() if len(columns) >= FEWEST}
