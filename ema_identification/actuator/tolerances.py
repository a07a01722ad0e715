"""Where the tolerances of several records of one unit are in one vector."""

from __future__ import annotations

import numpy as np

from ema_identification.actuator.spread import N_TOLERANCES, TOLERANCES

SHARED = np.array([t.shared for t in TOLERANCES])
"""Those of the unit; the others belong to the record."""


class Tolerances:
    """Tolerances of several records: shared ones once, the others once a record."""

    def __init__(self, records: int) -> None:
        n_shared = int(SHARED.sum())
        self.size = n_shared + records * (N_TOLERANCES - n_shared)
        self._columns = []
        own = n_shared
        for _ in range(records):
            columns = np.empty(N_TOLERANCES, dtype=int)
            columns[SHARED] = np.arange(n_shared)
            columns[~SHARED] = np.arange(own, own + N_TOLERANCES - n_shared)
            own += N_TOLERANCES - n_shared
            self._columns.append(columns)

    def of(self, record: int, z: np.ndarray) -> np.ndarray:
        """Return the tolerances of one record, shape (18,), from all, shape (size,)."""
        return np.asarray(z[self._columns[record]])

    def spread(self, record: int, slope: np.ndarray) -> np.ndarray:
        """Return columns for all tolerances, shape (d, size), from those of one record."""
        found = np.zeros((len(slope), self.size))
        found[:, self._columns[record]] = slope
        return found
