"""What is known about records of one profile from one model: the type of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ema_identification.actuator.effect_library import Signature
from ema_identification.actuator.features import FeatureMap
from ema_identification.actuator.null_library import NullLibrary
from ema_record.record import Record
from ema_sim.actuator import Model


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """What residuals and scores look like when nothing is hidden (`calibration`).

    Attributes
    ----------
    factor : ndarray, shape (d,). On the variance of each feature.
    fit : mean and standard deviation of the logarithm of the cost a feature.
    gain : median of the best candidate's gain, and the scale of its exponential tail.
    """

    factor: np.ndarray
    fit: tuple[float, float] = (0.3, 0.25)
    gain: tuple[float, float] = (10.0, 5.0)

    def p_gain(self, gain: float) -> float:
        """Return the probability of a larger best gain when nothing is hidden."""
        return min(1.0, 0.5 * math.exp(min(1.0, -(gain - self.gain[0]) / self.gain[1])))

    def p_fit(self, cost_a_feature: float) -> float:
        """Return the probability of a larger cost when the model is complete."""
        x = (math.log(max(cost_a_feature, 1e-9)) - self.fit[0]) / self.fit[1]
        return 0.5 * math.erfc(x / math.sqrt(2.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Library:
    """Features, effect-free statistics and signatures for one model and profile."""

    model: Model
    fmap: FeatureMap
    null: NullLibrary
    signatures: tuple[Signature, ...]
    """Empty for a record that is only predicted."""
    scale: Scale
    example: Record
    """Any record of the profile."""
