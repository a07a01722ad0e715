"""What stands in a model file: its fields, their bounds, and the way to arrays and back.

Plain numbers and names only; every length is bounded before an array is made of it.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ema_prognostics.cascade.classes import KINDS_FOUND, TAIL_RATES
from ema_prognostics.cascade.guard_groups import group_columns
from ema_prognostics.cascade.inputs import input_names
from ema_prognostics.cascade.lines import (
    ECCENTRIC_LINES,
    HARMONICS,
    SHORT_LINES,
    SPEEDS,
    WINDING,
    LineFilter,
)
from ema_prognostics.networks.network import Network

DIGITS = 7
"""Significant digits of a number in the file."""
MAX_FEATURES = MAX_HIDDEN = 400

View = Literal["fleet", "baseline"]
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
        values = {n: getattr(network, n) for n in cls.model_fields}
        return cls.model_validate({
            n: v if n == "output_law" else rounded(v) for n, v in values.items()})

    def build(self) -> Network:
        """Return the network as arrays."""
        values: dict[str, Any] = {n: v if n == "output_law" else np.array(v) for n, v in self}
        return Network(**values)

    def check_size(self, inputs: int, outputs: int) -> None:
        """Raise ValueError unless the network has that many inputs and outputs."""
        found = len(self.hidden_weights), len(self.output_bias)
        if found != (inputs, outputs):
            raise ValueError(f"a network of {found[0]} inputs and {found[1]} outputs, expected "
                             f"{inputs} and {outputs}")


class MemberPart(Part):
    """Which of a family: one network, and what it sees."""

    inputs: Names
    network: NetworkPart

    @model_validator(mode="after")
    def _sizes(self) -> MemberPart:
        self.network.check_size(len(self.inputs), 1)
        return self


class FamilyPart(MemberPart):
    """Whether a family is there; its logit means `logits` where it is `knots`, linear between."""

    threshold: Number
    """Logit of the network above which it is announced."""
    knots: Vector = Field(default=[0.0])
    logits: Vector = Field(default=[0.0])

    @model_validator(mode="after")
    def _curve(self) -> FamilyPart:
        if not 1 <= len(self.knots) == len(self.logits) or sorted(self.knots) != self.knots:
            raise ValueError("the logits of a family do not fit its knots")
        return self


class SeverityPart(Part):
    """How much: a network on asinh(severity / unit), one on the log of its error, the interval.

    The half width of the 90 % interval is the expected error times a factor, which is `factors`
    where the network says `knots`, and linear between, times `noise_factors`, which in the same
    manner depend on the noise of the record; beside another fault `company` times it.
    """

    inputs: Names
    network: NetworkPart
    scale: NetworkPart
    unit: Positive
    knots: Vector
    factors: Vector
    noise_knots: Vector = Field(default=[0.0])
    """Noise of the speed sensor, squashed in healthy deviations."""
    noise_factors: Vector = Field(default=[1.0])
    company: Positive
    upper: Positive
    """Largest severity trained on."""
    least: float = Field(ge=0.0)
    """Smallest severity that is announced."""

    @model_validator(mode="after")
    def _sizes(self) -> SeverityPart:
        self.network.check_size(len(self.inputs), 1)
        self.scale.check_size(len(self.inputs), 1)
        for knots, factors in ((self.knots, self.factors),
                               (self.noise_knots, self.noise_factors)):
            if not 1 <= len(knots) == len(factors) or sorted(knots) != knots:
                raise ValueError("the factors of an interval do not fit its knots")
            if min(factors) <= 0.0:
                raise ValueError("a factor of an interval is not above 0")
        return self


class LinePart(Part):
    """Matched filters on the torque lines."""

    weight: Matrix
    deviation: Vector
    template_re: Vector
    template_im: Vector
    winding_re: Vector
    winding_im: Vector
    precision: Matrix
    floor: Matrix
    by_noise: Matrix
    share: Annotated[float, Field(ge=0.0, le=1.0)]

    @classmethod
    def of(cls, found: LineFilter) -> LinePart:
        """Return filters as data."""
        return cls(weight=rounded(found.weight), deviation=rounded(found.deviation),
                   template_re=rounded(found.template.real),
                   template_im=rounded(found.template.imag),
                   winding_re=rounded(found.winding.real),
                   winding_im=rounded(found.winding.imag), precision=rounded(found.precision),
                   floor=rounded(found.floor), by_noise=rounded(found.by_noise),
                   share=float(f"{found.share:.6g}"))

    def build(self) -> LineFilter:
        """Return the filters as arrays."""
        return LineFilter(
            weight=np.array(self.weight), deviation=np.array(self.deviation),
            template=np.array(self.template_re) + 1j * np.array(self.template_im),
            winding=np.array(self.winding_re) + 1j * np.array(self.winding_im),
            precision=np.array(self.precision), floor=np.array(self.floor),
            by_noise=np.array(self.by_noise), share=self.share)

    @model_validator(mode="after")
    def _shapes(self) -> LinePart:
        good = (
            1 <= len(self.weight) <= len(SPEEDS)
            and all(len(row) == HARMONICS for row in self.weight)
            and len(self.deviation) == HARMONICS and min(self.deviation) > 0.0
            and len(self.template_re) == len(self.template_im) == len(SHORT_LINES)
            and len(self.winding_re) == len(self.winding_im) == len(WINDING)
            and [len(row) for row in self.precision] == [len(WINDING)] * len(WINDING)
            and all([len(row) for row in part] == [len(self.weight)] * len(ECCENTRIC_LINES)
                    and min(map(min, part)) > 0.0 for part in (self.floor, self.by_noise))
        )
        if not good:
            raise ValueError("the filters of the lines have another shape")
        return self


class GroupPart(Part):
    """How far the features of one part of the physics may be off together."""

    whitening: Matrix
    distance: Positive


class LimitPart(Part):
    """How far a kind of record may be off."""

    limit: Vector
    """Largest usual |residual| / scale of each checked feature."""
    whitening: Matrix
    """Makes the scaled residuals uncorrelated, of unit variance."""
    distance: Positive
    """Largest usual length of the whitened residuals."""
    tail: Vector
    """Worst score of a record that is exceeded at each of `classes.TAIL_RATES`; it grows."""
    groups: dict[str, GroupPart]
    """Of the features that belong together, see `guard_groups.GROUPS`."""

    @model_validator(mode="after")
    def _sizes(self) -> LimitPart:
        m = len(self.limit)
        if len(self.tail) != len(TAIL_RATES) or sorted(self.tail) != self.tail:
            raise ValueError("the tail of the guard's scores has another shape")
        if min(self.limit, default=1.0) <= 0.0:
            raise ValueError("a limit of the guard is not above 0")
        if len(self.whitening) != m or any(len(row) != m for row in self.whitening):
            raise ValueError("the whitening does not fit the checked features")
        return self


class GuardPart(Part):
    """What the record must look like, given the features that faults move."""

    drivers: Names
    checked: Names
    mean: NetworkPart
    scale: NetworkPart
    limits: dict[Literal["healthy", "slight", "mechanical", "electrical", "both"], LimitPart]
    """By what is found in a record: friction and backlash move other features than shorts."""
    seen: dict[str, tuple[Number, Number]]
    """Least and largest value of each measured condition in training, squashed."""

    @model_validator(mode="after")
    def _sizes(self) -> GuardPart:
        if not set(self.seen) <= set(self.drivers):
            raise ValueError("a measured condition is no driver of the guard")
        self.mean.check_size(len(self.drivers), len(self.checked))
        self.scale.check_size(len(self.drivers), len(self.checked))
        if set(self.limits) != set(KINDS_FOUND):
            raise ValueError("limits of the guard are missing")
        if any(len(part.limit) != len(self.checked) for part in self.limits.values()):
            raise ValueError("one limit a checked feature is needed")
        sizes = {name: len(columns)
                 for name, columns in group_columns(tuple(self.checked)).items()}
        for part in self.limits.values():
            found = {name: [len(row) for row in g.whitening] for name, g in part.groups.items()}
            if found != {name: [n] * n for name, n in sizes.items()}:
                raise ValueError("the groups of the guard are others")
        return self


class FilterPart(Part):
    """The filters for one kind of stranger, see `guard`: one for each of `KINDS_FOUND`."""

    weights: Annotated[Matrix, Field(min_length=len(KINDS_FOUND), max_length=len(KINDS_FOUND))]
    """Of the squashed inputs; a filter's variance over known records is 1."""
    turns: Literal[1, 3]
    """3: it may be of any phase, so the record is looked at from each."""
    both: bool
    """Whether it may be of either sign; else the output is positive."""
    limits: Annotated[list[Positive], Field(
        min_length=len(KINDS_FOUND), max_length=len(KINDS_FOUND))]
    """Largest usual size of each filter's output."""


class StrangersPart(Part):
    """The filters for strangers, by kind."""

    filters: dict[str, FilterPart] = Field(min_length=1, max_length=40)


class ViewPart(Part):
    """The cascade of one kind of test, with or without a baseline."""

    names: Names
    lines: LinePart
    absolute_lines: LinePart | None
    """With a baseline: of the features themselves, beside the differences."""
    center: Vector
    spread: Vector
    """Of the healthy fleet, of each input: the features, and what `lines` derives of them."""
    families: dict[str, FamilyPart]
    members: dict[str, MemberPart]
    severity: dict[str, SeverityPart]
    doubt: Annotated[float, Field(ge=0.0, le=1.0)]
    """Least probability of healthy at which a record without a fault is called healthy."""
    guard: GuardPart
    strangers: StrangersPart | None = None
    """What else befalls actuators; None: only the guard tells it."""

    @model_validator(mode="after")
    def _sizes(self) -> ViewPart:
        d = len(input_names(self.names))
        if len(self.center) != d or len(self.spread) != d or min(self.spread, default=0.0) <= 0:
            raise ValueError("one centre and one positive spread an input are needed")
        speeds = [s for s in SPEEDS if f"{s}_even_m1_re" in self.names]
        for part in (self.lines, self.absolute_lines):
            if part is not None and len(part.weight) != len(speeds):
                raise ValueError("the filters of the lines do not fit the features")
        if self.strangers is not None and any(
                len(row) != d for one in self.strangers.filters.values() for row in one.weights):
            raise ValueError("a filter of the strangers does not fit the inputs")
        if not {*self.guard.drivers, *self.guard.checked} <= {*input_names(self.names)}:
            raise ValueError("the guard names inputs that the view does not have")
        return self


class DiscrepancyPart(Part):
    """What healthy machines leave over the model, feature by feature."""

    names: Names
    mean: Vector
    """Subtracted from the features of a record."""
    spread: Vector
    """Standard deviation between units, which the training was given."""

    @model_validator(mode="after")
    def _sizes(self) -> DiscrepancyPart:
        if not len(self.names) == len(self.mean) == len(self.spread):
            raise ValueError("one mean and one spread a feature of the discrepancy are needed")
        return self
