"""The network of the cascade at work: plain arrays, numpy only, no training.

A perceptron with one hidden layer, log-sigmoid in the hidden layer and, for pattern
recognition, in the output layer too (paper, section V.D).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

OutputLaw = Literal["logsig", "linear"]


def logsig(x: np.ndarray) -> np.ndarray:
    """Return the log-sigmoid 1 / (1 + exp(-x)), without overflow."""
    return 0.5 + 0.5 * np.tanh(0.5 * x)


def logit(p: np.ndarray) -> np.ndarray:
    """Return log(p / (1 − p)), bounded."""
    p = np.clip(p, 1e-12, 1.0 - 1e-12)
    return np.log(p / (1.0 - p))


@dataclass(frozen=True, slots=True, kw_only=True)
class Network:
    """A trained perceptron with one hidden layer.

    Attributes
    ----------
    input_mean, input_scale : ndarray, shape (d,). Inputs enter as (x - mean) / scale.
    hidden_weights : ndarray, shape (d, h); hidden_bias : ndarray, shape (h,).
    output_weights : ndarray, shape (h, k); output_bias : ndarray, shape (k,).
    output_law : log-sigmoid (pattern recognition) or linear (a quantity).
    output_mean, output_scale : ndarray, shape (k,). Outputs leave as mean + scale * y.
    """

    input_mean: np.ndarray
    input_scale: np.ndarray
    hidden_weights: np.ndarray
    hidden_bias: np.ndarray
    output_weights: np.ndarray
    output_bias: np.ndarray
    output_law: OutputLaw
    output_mean: np.ndarray
    output_scale: np.ndarray

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the outputs, shape (n, k), for inputs `x`, shape (n, d)."""
        z = logsig((x - self.input_mean) / self.input_scale @ self.hidden_weights
                   + self.hidden_bias)
        y = z @ self.output_weights + self.output_bias
        if self.output_law == "logsig":
            y = logsig(y)
        return self.output_mean + self.output_scale * y
