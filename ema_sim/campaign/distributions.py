"""Distributions of a campaign's parameters, as a campaign file writes them."""

from __future__ import annotations

import math
import zlib
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

MAX_VALUES = 10_000
"""Longest list of a choice or a grid."""
KINDS = ("uniform", "log_uniform", "normal", "choice", "grid")
TRIES = 10_000
"""Draws after which a normal distribution is said to miss its bounds."""

Number = Annotated[float, Field(allow_inf_nan=False)]
Value = int | float | str
Values = Annotated[tuple[Value, ...], Field(min_length=1, max_length=MAX_VALUES)]


class Distribution(BaseModel):
    """How one parameter varies: exactly one kind; `relative` means times the nominal value."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    uniform: tuple[Number, Number] | None = None
    """Lower and upper end."""
    log_uniform: tuple[Number, Number] | None = None
    """Lower and upper end, both more than 0; uniform in the logarithm."""
    normal: tuple[Number, Number] | None = None
    """Mean and standard deviation; redrawn until within the parameter's bounds."""
    choice: Values | None = None
    """One of these, drawn with equal chance."""
    grid: Values | None = None
    """Each in turn; several grids give all their combinations."""
    relative: bool = False

    @model_validator(mode="after")
    def _one_kind(self) -> Distribution:
        if len([k for k in KINDS if getattr(self, k) is not None]) != 1:
            raise ValueError(f"give exactly one of {', '.join(KINDS)}")
        ends = self.uniform or self.log_uniform
        if ends is not None and ends[0] > ends[1]:
            raise ValueError("the lower end comes first")
        if self.log_uniform is not None and self.log_uniform[0] <= 0.0:
            raise ValueError("log_uniform: both ends must be more than 0")
        if self.normal is not None and self.normal[1] < 0.0:
            raise ValueError("normal: the standard deviation must not be negative")
        values = self.choice or self.grid or ()
        if any(isinstance(v, float) and not math.isfinite(v) for v in values):
            raise ValueError("values must be finite")
        if self.relative and any(isinstance(v, str) for v in values):
            raise ValueError("relative: values must be numbers")
        return self

    @property
    def kind(self) -> str:
        """Name of the kind that is given."""
        return next(k for k in KINDS if getattr(self, k) is not None)

    @property
    def extremes(self) -> tuple[Value, ...]:
        """Values that must lie within the bounds of the parameter: ends, or all listed."""
        if self.normal is not None:
            return (self.normal[0],)
        found: tuple[Value, ...] = getattr(self, self.kind)
        return found

    def draw(
        self, rng: np.random.Generator, lower: float = -math.inf, upper: float = math.inf
    ) -> Value:
        """Return one value; a normal one lies within [`lower`, `upper`]. Not for a grid.

        Raises
        ------
        ValueError
            The normal distribution misses the bounds.
        """
        if self.uniform is not None:
            return float(rng.uniform(*self.uniform))
        if self.log_uniform is not None:
            low, high = self.log_uniform
            value = math.exp(rng.uniform(math.log(low), math.log(high)))
            return min(max(value, low), high)
        if self.normal is not None:
            for _ in range(TRIES):
                value = float(rng.normal(*self.normal))
                if lower <= value <= upper:
                    return value
            raise ValueError(f"no draw of {TRIES} lies within {lower:g} to {upper:g}")
        assert self.choice is not None
        return self.choice[int(rng.integers(len(self.choice)))]


def stream(seed: int, index: int, name: str) -> np.random.SeedSequence:
    """Return the random stream of one parameter of one run.

    It depends on nothing else: not on the number of runs, on other parameters, on workers.
    """
    return np.random.SeedSequence(entropy=seed, spawn_key=(index, zlib.crc32(name.encode())))
