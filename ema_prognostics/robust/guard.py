"""The guard: whether a record looks like anything that the networks were trained on.

Faults move some features (the drivers: lines, torques, gap). Given these, all others are
predicted, with their scatter; a record whose others lie elsewhere is of an unknown kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ema_prognostics.model_body import GuardPart, LimitPart, ViewPart
from ema_prognostics.network import Network, logit
from ema_prognostics.robust.vector import ABSOLUTE

DRIVERS = ("quarter_even_", "torque_quarter", "gap_torque", "gap_width", "load_quarter",
           "temperature", "bus_voltage", "speed_full", "full_even_m1", "full_even_m2",
           "full_even_m3")
STEP_DRIVERS = ("full_even_", "torque_", "temp", "bus_", "speed_full")
"""Features that faults move."""
NOT_CHECKED = ("gap_width_difference",)
FLOOR = 0.02
"""Least scatter, in the squashed unit."""


ABSOLUTE_DRIVERS = tuple(f"{ABSOLUTE}{n}" for n in (
    "temperature", "bus_voltage", "torque_quarter", "torque_full", "noise_speed", "gap_width",
    "gap_torque", "load_quarter", "speed_full"))
"""Of the features themselves, beside the differences to a baseline."""
STEEPNESS = 4.0
"""Logits by which a score grows e-fold."""
MARGIN = 1.5
"""On the limits, where the test is not exactly the one trained on."""
SQUEEZE = 3.0
"""Scaled residual beyond which a single feature adds little to the distance."""


def drivers_of(names: list[str], kind: str) -> list[str]:
    """Return the names of the drivers."""
    if kind == "step":
        own = [n for n in names if n.startswith(STEP_DRIVERS)]
    else:
        own = [n for n in names if n.startswith(DRIVERS) and n not in {
            "torque_quarter_over_ramp", *NOT_CHECKED}]
    return [*own, *(n for n in names if n in ABSOLUTE_DRIVERS)]


def checked_of(names: list[str], kind: str) -> list[str]:
    """Return the names of the features that are checked; with a baseline the differences."""
    out = {*drivers_of(names, kind), *NOT_CHECKED}
    return [n for n in names if n not in out and not n.startswith(ABSOLUTE)]


def squeeze(z: np.ndarray) -> np.ndarray:
    """Return scaled residuals, bounded so that one alone does not make the distance."""
    return SQUEEZE * np.tanh(z / SQUEEZE)


class Limits(NamedTuple):
    """How far a kind of record may be off."""

    limit: np.ndarray
    """Usual bound of |residual| / scatter, shape (m,)."""
    whitening: np.ndarray
    """Of the squeezed, scaled residuals, shape (m, m)."""
    distance: float
    """Usual bound of the whitened residuals' length."""
    stranger: float
    """Usual bound of the logit of the network that knows strangers."""

    def scores(self, z: np.ndarray, strange: np.ndarray) -> np.ndarray:
        """Return how far off each feature is, all are together, and how strange; 1: the limit.

        Parameters
        ----------
        z : ndarray, shape (n, m). Scaled residuals.
        strange : ndarray, shape (n,). Logit of the network that knows strangers.

        Returns
        -------
        ndarray, shape (n, m + 2).
        """
        length = np.linalg.norm(squeeze(z) @ self.whitening.T, axis=1)
        return np.column_stack([
            np.abs(z) / self.limit, length / self.distance,
            np.exp(np.clip((strange - self.stranger) / STEEPNESS, -20.0, 20.0)),
        ])


@dataclass(frozen=True, slots=True, kw_only=True)
class Guard:
    """The guard at work.

    Attributes
    ----------
    drivers, checked : columns of the features.
    mean, scale : networks from drivers to the checked features, and to the log of the scatter.
    stranger : network from squeezed residuals to the probability of a stranger.
    known, healthy : limits for records with a fault, and without one.
    """

    drivers: np.ndarray
    checked: np.ndarray
    mean: Network
    scale: Network
    stranger: Network
    known: Limits
    healthy: Limits

    def residuals(self, u: np.ndarray) -> np.ndarray:
        """Return the scaled residuals, shape (n, m), of squashed features, shape (n, d)."""
        x = u[:, self.drivers]
        return (u[:, self.checked] - self.mean(x)) / (np.exp(self.scale(x)) + FLOOR)

    def scores(self, u: np.ndarray, sound: np.ndarray, *, exact: bool = True) -> np.ndarray:
        """Return how far off the checked features are, shape (n, m + 2), as `Limits.scores`.

        Parameters
        ----------
        u : ndarray, shape (n, d). Squashed features.
        sound : ndarray of bool, shape (n,). Whether no fault is found in the record.
        exact : whether the test is exactly the one trained on; of others only single features
            are judged, by the wider limits and with a margin.
        """
        z = self.residuals(u)
        if not exact:
            single = np.abs(z) / (MARGIN * self.known.limit)
            return np.column_stack([single, np.zeros((len(z), 2))])
        strange = logit(self.stranger(squeeze(z))[:, 0])
        return np.where(
            sound[:, None], self.healthy.scores(z, strange), self.known.scores(z, strange))


def _limits(part: LimitPart) -> Limits:
    return Limits(np.array(part.limit), np.array(part.whitening), part.distance,
                  part.stranger)


def build_guard(view: ViewPart, data: GuardPart) -> Guard:
    """Return the guard of a view."""
    return Guard(
        drivers=np.array([view.names.index(n) for n in data.drivers]),
        checked=np.array([view.names.index(n) for n in data.checked]),
        mean=data.mean.build(), scale=data.scale.build(), stranger=data.stranger.build(),
        known=_limits(data.known), healthy=_limits(data.healthy),
    )
