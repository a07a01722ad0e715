"""The guard: whether a record looks like anything that the networks were trained on.

Faults move some features (the drivers: lines, torques, gap). Given these, all others are
predicted, with their scatter; a record whose others lie elsewhere is of an unknown kind.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_prognostics.model_body import GuardPart, ViewPart
from ema_prognostics.network import Network

DRIVERS = ("quarter_even_", "torque_quarter", "gap_torque", "gap_width", "load_quarter",
           "temperature", "bus_voltage", "speed_full", "full_even_m1", "full_even_m2",
           "full_even_m3")
STEP_DRIVERS = ("full_even_", "torque_", "temp", "bus_", "speed_full")
"""Features that faults move."""
NOT_CHECKED = ("gap_width_difference",)
FLOOR = 0.02
"""Least scatter, in the squashed unit."""


def drivers_of(names: list[str], kind: str) -> list[str]:
    """Return the names of the drivers."""
    if kind == "step":
        return [n for n in names if n.startswith(STEP_DRIVERS)]
    return [n for n in names if n.startswith(DRIVERS) and n not in {
        "torque_quarter_over_ramp", *NOT_CHECKED}]


@dataclass(frozen=True, slots=True, kw_only=True)
class Guard:
    """The guard at work.

    Attributes
    ----------
    drivers, checked : columns of the features.
    mean, scale : networks from drivers to the checked features, and to the log of the scatter.
    limit : ndarray, shape (m,). Usual bound of |residual| / scatter.
    """

    drivers: np.ndarray
    checked: np.ndarray
    mean: Network
    scale: Network
    limit: np.ndarray

    def scores(self, u: np.ndarray) -> np.ndarray:
        """Return how far each checked feature is off, 1 the limit, shape (n, m).

        Parameters
        ----------
        u : ndarray, shape (n, d). Squashed features.
        """
        x = u[:, self.drivers]
        residual = u[:, self.checked] - self.mean(x)
        return np.abs(residual) / (np.exp(self.scale(x)) + FLOOR) / self.limit


def build_guard(view: ViewPart, data: GuardPart) -> Guard:
    """Return the guard of a view."""
    return Guard(
        drivers=np.array([view.names.index(n) for n in data.drivers]),
        checked=np.array([view.names.index(n) for n in data.checked]),
        mean=data.mean.build(), scale=data.scale.build(), limit=np.array(data.limit),
    )
