"""Concavity of the two-phase-on portions of the reference currents (paper, section V.B).

A phase carries current in two portions of a turn, each 120° wide: positive around 90°,
negative around 270° of its own angle. Each portion, folded over all turns of the window and
trimmed at both ends, is fitted by a polynomial of second degree; its curvature is the
concavity.
"""

from __future__ import annotations

import numpy as np

from ema_prognostics.features.turns import TURN, Turns
from ema_record.channels import REFERENCE_CURRENTS
from ema_record.errors import InvalidRecordError

TRIM = np.deg2rad(8.0)
"""Left out at both ends of a portion (rad)."""
HALF_PORTION = np.deg2rad(60.0) - TRIM
"""Half width of what is fitted (rad)."""


def portion_centre(phase: int, positive: bool) -> float:
    """Return the rotor angle in the middle of a portion (rad)."""
    return (0.25 if positive else 0.75) * TURN + phase * TURN / 3.0


def portions(turns: Turns) -> np.ndarray:
    """Return the second-degree fits of the six portions.

    Returns
    -------
    ndarray, shape (2, 3, 3). [positive or negative portion, phase, coefficient of 1, u, u²]
    in A, where u = -1..1 runs along the trimmed portion.
    """
    current = turns.samples[:, REFERENCE_CURRENTS]
    fits = np.empty((2, 3, 3))
    for sign in range(2):
        for phase in range(3):
            centre = portion_centre(phase, sign == 0)
            u = (np.mod(turns.theta - centre + 0.5 * TURN, TURN) - 0.5 * TURN) / HALF_PORTION
            inside = np.abs(u) <= 1.0
            if np.count_nonzero(inside) < 6:
                raise InvalidRecordError(
                    f"{np.count_nonzero(inside)} samples in a two-phase-on portion, at least "
                    "6: record at a higher rate"
                )
            u = u[inside]
            design = np.stack([np.ones_like(u), u, u * u], axis=1)
            weighted = design * turns.weight[inside, None]
            fits[sign, phase] = np.linalg.solve(
                weighted.T @ design, weighted.T @ current[inside, phase]
            )
    return fits


def concavity(turns: Turns) -> np.ndarray:
    """Return the concavity, shape (2, 3): [positive or negative portion, phase] (A).

    The sag of the fit against its chord, positive where the portion is convex.
    """
    return portions(turns)[:, :, 2]
