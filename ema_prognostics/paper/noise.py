"""The paper's noise: white, a part of the maximum of each signal (section V.A)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ema_prognostics.features.turns import Turns
from ema_record.actuator import load_actuator
from ema_record.channels import MOTOR_SPEED, PHASE_CURRENTS, REFERENCE_CURRENTS

NOISE_LEVELS = (0.0, 0.025, 0.05)
"""Deviation as a part of the maximum of the signal in the window."""
REFERENCE_RATE = 1e6
"""Rate at which the levels hold (1/s).

White noise makes any result depend on the bandwidth. A sample here is the mean over its
interval, so the deviation a sample is the level divided by sqrt(REFERENCE_RATE / rate).
"""


def add_noise(
    turns: Turns, level: float, rng: np.random.Generator, rate: float | None = None
) -> Turns:
    """Return `turns` with white noise on speed and currents.

    Parameters
    ----------
    turns : the window.
    level : deviation at `REFERENCE_RATE`, as a part of the largest magnitude in the window.
    rng : where the noise comes from.
    rate : samples a second, default that of the nominal acquisition.
    """
    if level == 0.0:
        return turns
    samples = turns.samples.copy()
    rate = load_actuator().acquisition.rate if rate is None else rate
    scale = level / np.sqrt(REFERENCE_RATE / rate)
    for columns in (slice(MOTOR_SPEED, MOTOR_SPEED + 1), PHASE_CURRENTS, REFERENCE_CURRENTS):
        block = samples[:, columns]
        block += rng.standard_normal(block.shape) * (scale * np.abs(block).max())
    return replace(turns, samples=samples)
