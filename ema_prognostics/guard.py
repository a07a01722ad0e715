"""The guard: it refuses records that are unlike all that the networks were trained on.

Three checks beside ANN_A. *Lines*: distance to the nearest training records of the class that
was named. *Band*: Mahalanobis distance of the mechanical features from those of sound units.
*Wear*: a network that knows heavy friction and lost motion. Each answers with a ratio; above 1
the record is not accepted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_prognostics.network import Network

NEIGHBOURS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class LineGuard:
    """Distance to training records of one class.

    Attributes
    ----------
    points : ndarray, shape (n, 8). Training records, `line_inputs.guard_inputs`.
    scale : ndarray, shape (8,). limit : largest distance accepted.
    """

    points: np.ndarray
    scale: np.ndarray
    limit: float

    def distance(self, inputs: np.ndarray) -> np.ndarray:
        """Return the mean distance to the nearest records, shape (n,)."""
        delta = (inputs[:, None, :] - self.points[None]) / self.scale
        squares = np.sort(np.sum(delta**2, axis=2), axis=1)[:, :NEIGHBOURS]
        return np.sqrt(squares).mean(axis=1)

    def ratio(self, inputs: np.ndarray) -> np.ndarray:
        """Return distance / limit, shape (n,)."""
        return self.distance(inputs) / self.limit


@dataclass(frozen=True, slots=True, kw_only=True)
class MechanicsGuard:
    """Mechanical features of sound units, given the estimated short, and what wear makes.

    Attributes
    ----------
    names : the features.
    trend : ndarray, shape (3, d). Mean features as polynomial in the short x: 1, x, x².
    inverse_covariance : ndarray, shape (d, d).
    deviation : ndarray, shape (d,). Of a sound unit.
    band_limit : largest Mahalanobis distance accepted.
    wear : network, outputs sound, friction, backlash; inputs the features and x.
    wear_limit : largest value of the greater wear output accepted.
    """

    names: tuple[str, ...]
    trend: np.ndarray
    inverse_covariance: np.ndarray
    deviation: np.ndarray
    band_limit: float
    wear: Network
    wear_limit: float

    def excess(self, mechanics: np.ndarray, short: np.ndarray) -> np.ndarray:
        """Return features less those of sound units, shape (n, d)."""
        return mechanics - np.vander(short, 3, increasing=True) @ self.trend

    def band(self, mechanics: np.ndarray, short: np.ndarray) -> np.ndarray:
        """Return the Mahalanobis distance, shape (n,)."""
        excess = self.excess(mechanics, short)
        return np.sqrt(np.einsum("ni,ij,nj->n", excess, self.inverse_covariance, excess))

    def band_ratio(self, mechanics: np.ndarray, short: np.ndarray) -> np.ndarray:
        """Return distance / limit, shape (n,)."""
        return self.band(mechanics, short) / self.band_limit

    def wear_outputs(self, mechanics: np.ndarray, short: np.ndarray) -> np.ndarray:
        """Return the outputs sound, friction, backlash, shape (n, 3)."""
        return self.wear(np.column_stack([mechanics, short]))

    def wear_ratio(self, mechanics: np.ndarray, short: np.ndarray) -> np.ndarray:
        """Return greater wear output / limit, shape (n,)."""
        return self.wear_outputs(mechanics, short)[:, 1:].max(axis=1) / self.wear_limit
