"""The paper's two networks, literally: ANN_A names the fault, ANN_B its level (section V).

There is no healthy class: a healthy actuator is called one of the two faults, as in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ema_prognostics.networks.network import Network
from ema_prognostics.paper.features import (
    ANN_A_INPUTS,
    ECCENTRICITY_INPUTS,
    TURN_SHORT_INPUTS,
    PaperFeatures,
)

FaultName = Literal["turn_short", "rotor_eccentricity"]
FAULTS: tuple[FaultName, ...] = ("turn_short", "rotor_eccentricity")
"""Columns of ANN_A's target."""
N_EXTENTS = 21
EXTENTS: dict[FaultName, np.ndarray] = {
    "turn_short": np.linspace(0.02, 0.25, N_EXTENTS),
    "rotor_eccentricity": np.linspace(0.002, 0.034, N_EXTENTS),
}
"""Extents of the training set, rows 1 to 21: shorted part of the turns, and ζ.

Row 14 is a short of 17 %, the paper's cut at 82.81 % active turns (Fig. 13); rows 6 and 14
are 1.0 % and 2.3 % eccentricity, where the outputs of its Fig. 16 change over.
"""
CUTS: dict[int, tuple[int, ...]] = {2: (1, 14, 21), 3: (1, 6, 14, 21)}
"""First and last rows of the columns; neighbours share the row at the cut."""
ANN_B_INPUTS: dict[FaultName, tuple[str, ...]] = {
    "turn_short": TURN_SHORT_INPUTS, "rotor_eccentricity": ECCENTRICITY_INPUTS,
}
LEVELS = ("small", "medium", "large")
"""Of ANN_B with three columns."""


def level_target(rows: np.ndarray, columns: int) -> np.ndarray:
    """Return ANN_B's target, shape (n, columns), for `rows` 1..21, shape (n,)."""
    cuts, rows = np.array(CUTS[columns]), rows[:, None]
    return ((rows >= cuts[:-1]) & (rows <= cuts[1:])).astype(int)


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperCascade:
    """ANN_A and one ANN_B with three columns a fault."""

    ann_a: Network
    ann_b: dict[str, Network]

    def classify(self, features: PaperFeatures) -> np.ndarray:
        """Return the outputs of ANN_A, shape (2,), in the order of `FAULTS`."""
        return self.ann_a(features.vector(ANN_A_INPUTS)[None])[0]

    def level(self, fault: FaultName, features: PaperFeatures) -> np.ndarray:
        """Return the outputs of ANN_B for that fault, shape (3,)."""
        return self.ann_b[fault](features.vector(ANN_B_INPUTS[fault])[None])[0]
