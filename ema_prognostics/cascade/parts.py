"""What every part of a model file is made of: bounded numbers, names, networks."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ema_prognostics.networks.network import Network

DIGITS = 7
"""Significant digits of a number in the file."""
MAX_FEATURES = MAX_HIDDEN = 400

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Positive = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e12)]
Vector = Annotated[list[Number], Field(max_length=2 * MAX_FEATURES)]
Matrix = Annotated[list[Vector], Field(max_length=2 * MAX_FEATURES)]
Names = Annotated[list[Annotated[str, Field(max_length=80)]], Field(max_length=MAX_FEATURES)]


def rounded(values: np.ndarray) -> Any:
    """Return an array as nested lists of numbers with `DIGITS` digits."""
    if values.ndim == 0:
        return float(f"{float(values):.{DIGITS}g}") + 0.0
    return [rounded(v) for v in values]


class Part(BaseModel):
    """A part of the body."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)


class NetworkPart(Part):
    """A perceptron with one hidden layer."""

    input_mean: Vector
    input_scale: Vector
    hidden_weights: Matrix
    hidden_bias: Vector
    output_weights: Matrix
    output_bias: Vector
    output_law: Literal["logsig", "linear"]
    output_mean: Vector
    output_scale: Vector

    @model_validator(mode="after")
    def _shapes(self) -> NetworkPart:
        d, h, k = len(self.hidden_weights), len(self.hidden_bias), len(self.output_bias)
        good = (
            d > 0 and 0 < h <= MAX_HIDDEN and k > 0
            and all(len(row) == h for row in self.hidden_weights)
            and len(self.output_weights) == h and all(len(r) == k for r in self.output_weights)
            and len(self.output_mean) == k and len(self.output_scale) == k
            and len(self.input_mean) == d and len(self.input_scale) == d
        )
        if not good:
            raise ValueError("the shapes of the layers do not fit together")
        if min(self.input_scale) <= 0.0:
            raise ValueError("an input scale is not above 0")
        return self

    @classmethod
    def of(cls, network: Network) -> NetworkPart:
        """Return a network as data."""
        values = {n: getattr(network, n) for n in cls.model_fields if n != "output_law"}
        return cls.model_validate({
            **{n: rounded(np.asarray(v)) for n, v in values.items()},
            "output_law": network.output_law,
        })

    def build(self) -> Network:
        """Return the network as arrays."""
        values = {n: np.array(getattr(self, n)) for n in type(self).model_fields
                  if n != "output_law"}
        return Network(**values, output_law=self.output_law)

    def check_size(self, inputs: int, outputs: int) -> None:
        """Raise ValueError unless the network has that many inputs and outputs."""
        found = len(self.hidden_weights), len(self.output_bias)
        if found != (inputs, outputs):
            raise ValueError(f"a network of {found[0]} inputs and {found[1]} outputs, expected "
                             f"{inputs} and {outputs}")
