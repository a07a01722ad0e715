"""Offset and gain errors of the current sensors, read off the record itself.

Offsets: the inverter is off at the beginning of a test, the currents are zero. Gains: the true
currents of a star sum to zero, so the readings do not vary along one direction, which is the
smallest eigenvector of ⟨i iᵀ⟩; white noise, equal in the phases, does not turn it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_record.channels import PHASE_CURRENTS
from ema_record.record import Record

GUARD_TIME = 1e-3
"""Left out before the inverter switches on (s)."""
MIN_SAMPLES = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class CurrentSensors:
    """Errors of the three current sensors.

    Attributes
    ----------
    offset : ndarray, shape (3,) (A), zero where the record has no interval without current.
    gain : ndarray, shape (3,), relative to their mean.
    """

    offset: np.ndarray
    gain: np.ndarray

    def correct(self, currents: np.ndarray) -> np.ndarray:
        """Return readings, shape (n, 3) (A), without the errors."""
        return (currents - self.offset) / self.gain


def current_sensors(record: Record) -> CurrentSensors:
    """Return the errors of the current sensors in a record."""
    currents = record.samples[:, PHASE_CURRENTS]
    off = record.time < record.profile.inverter_off - GUARD_TIME
    offset = currents[off].mean(axis=0) if np.count_nonzero(off) >= MIN_SAMPLES else np.zeros(3)
    on = currents[~off] - offset
    _, vectors = np.linalg.eigh(on.T @ on)
    normal = np.abs(vectors[:, 0])
    if normal.min() < 0.2:  # a phase carries no current: no gain can be told
        return CurrentSensors(offset=offset, gain=np.ones(3))
    gain = 1.0 / normal
    return CurrentSensors(offset=offset, gain=gain / gain.mean())
