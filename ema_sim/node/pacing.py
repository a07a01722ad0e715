"""Pacing of the simulated time to real time by deadlines, so that no error adds up."""

from __future__ import annotations

import math
from dataclasses import dataclass

UNPACED_BUDGET = 0.010
"""Wall time of one turn when the simulation runs as fast as it can (s)."""


@dataclass(frozen=True, slots=True)
class Pacer:
    """Says how much of a run is due.

    Attributes
    ----------
    begin : clock at the begin of the run (s).
    factor : simulated seconds a second, 0 for as fast as possible.
    """

    begin: float
    factor: float

    def due(self, now: float) -> float:
        """Return the simulated time up to which samples are due at clock `now` (s)."""
        if self.factor == 0.0:
            return math.inf
        return (now - self.begin) * self.factor
