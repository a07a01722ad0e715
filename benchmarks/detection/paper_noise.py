"""Verdicts at the paper's noise: 5 % of each signal's largest value, in both readings.

White noise depends on the bandwidth: 5 % a sample at 20 kHz, or 5 % a sample at 1 MS/s, which
the acquisition's mean over 50 samples leaves as 0.7 %.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from benchmarks.detection.fleet import draw, record_of
from ema_prognostics.cascade.model_file import Model
from ema_prognostics.verdict.diagnose import diagnose
from ema_record.channels import MOTOR_SPEED, PHASE_CURRENTS
from ema_record.record import Record

LEVEL = 0.05
READINGS = {"nominal": 0.0, "5 % at 1 MS/s": LEVEL / np.sqrt(50.0), "5 % at 20 kHz": LEVEL}
WINDOW = (0.06, 0.36)
"""Where the paper takes the largest values (s after the command)."""
GROUPS = ("healthy", "turn_short", "rotor_eccentricity", "motor_friction", "backlash")
FIRST_SEED = 5_000_000


def noisy(record: Record, level: float, rng: np.random.Generator) -> Record:
    """Return `record` with white noise of `level` times the largest value on each signal."""
    samples = record.samples.copy()
    start = record.profile.command_time
    window = (record.time > start + WINDOW[0]) & (record.time < start + WINDOW[1])
    for column in (MOTOR_SPEED, *range(*PHASE_CURRENTS.indices(samples.shape[1]))):
        largest = float(np.abs(samples[window, column]).max())
        samples[:, column] += level * largest * rng.normal(size=len(samples))
    return Record(samples=samples, profile=record.profile, provenance=record.provenance,
                  dc_bus=record.dc_bus, winding_temperature=record.winding_temperature)


def paper_noise(model: Model, units: int) -> dict[str, dict[str, dict[str, int]]]:
    """Return, for each reading and group, how often the verdict is what; fleet view."""
    table: dict[str, dict[str, Counter[str]]] = {r: {} for r in READINGS}
    for group in GROUPS:
        for n in range(units):
            actuator, _, case = draw(group, FIRST_SEED + n)
            record = record_of(actuator, case)
            rng = np.random.default_rng(case.seed)
            for reading, level in READINGS.items():
                verdict = diagnose(noisy(record, level, rng) if level else record, model)
                said: Any = "+".join(sorted(f.fault_class for f in verdict.faults))
                table[reading].setdefault(group, Counter())[said or verdict.outcome] += 1
    return {r: {g: dict(c) for g, c in rows.items()} for r, rows in table.items()}
