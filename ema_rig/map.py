"""Map files: which column of a foreign file is what, in YAML (docs/rigs.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from ema_record.channels import CHANNEL_NAMES, TIME, what_lacks
from ema_record.errors import UsageError, validated
from ema_record.record import UNKNOWN_SERIAL
from ema_record.yaml_file import load_yaml
from ema_rig.record import InputQuantity

SEE = "docs/rigs.md shows the form"
RIG_COLUMNS = ("input", "position", "speed", "output_position", "reference_position",
               "reference_speed", "disturbance")
"""Columns of a rig, keys of its map."""
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
OF_THE_ACTUATOR = {"serial_number", "bus_voltage", "winding_temperature"}
ColumnName = Annotated[str, Field(min_length=1, max_length=200)] | Annotated[
    int, Field(ge=0, le=9999)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class ColumnTime(_Part):
    """When a column was sampled, where it has a clock of its own."""

    column: ColumnName
    unit: str = Field(default="s", max_length=20)


class Column(_Part):
    """One column: where it stands, its unit, and a scale with sign after the conversion."""

    column: ColumnName
    """Name as in the file, or number from 0. ``name[2]`` is column 2 of a matrix in MAT, NPZ."""
    unit: str = Field(min_length=1, max_length=20)
    scale: Finite = 1.0
    """Multiplies what was converted; -1 turns the direction."""
    zero: Finite = 0.0
    """Subtracted before anything else, in the unit of the column."""
    unwrap: float | None = Field(default=None, gt=0.0, le=1e18)
    """After how much a counter starts again, in the unit of the column: 4096, 360."""
    time: ColumnTime | None = None
    """Of its own, where it was not sampled with the others."""

    @model_validator(mode="after")
    def _scale_is_not_zero(self) -> Column:
        if self.scale == 0.0:
            raise ValueError("a scale of 0 leaves nothing; leave the column out instead")
        return self


class InputColumn(Column):
    """The input: also what it acts as, where a constant turns it into another quantity."""

    acts_as: InputQuantity | None = None
    """Default: the quantity of its unit."""
    gain: Finite | Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """SI of `acts_as` a SI unit of the column (35.15 N/V), or the name of a scalar in the file."""

    @model_validator(mode="after")
    def _gain_and_quantity_come_together(self) -> InputColumn:
        if (self.gain is None) != (self.acts_as is None):
            raise ValueError("'gain' and 'acts_as' come together: the constant, and what it makes")
        return self


class TimeColumn(_Part):
    """The time: a column, or a rate where the file has none."""

    column: ColumnName | None = None
    unit: str = Field(default="s", max_length=20)
    rate: float | None = Field(default=None, gt=0.0, le=1e6)
    """Samples a second of a file without a column of time (1/s)."""
    zero: Finite = 0.0
    """Subtracted from all times, in this unit: when the test was commanded."""

    @model_validator(mode="after")
    def _one_of_both(self) -> TimeColumn:
        if (self.column is None) == (self.rate is None):
            raise ValueError("give either 'column' or 'rate'")
        return self


class RunColumn(_Part):
    """The column that numbers the runs of a file that holds several."""

    column: ColumnName
    only: tuple[Finite | Annotated[str, Field(max_length=200)], ...] = Field(
        default=(), max_length=1000, strict=False)
    """Numbers or words of the runs to take; all where empty."""


class BagSource(_Part):
    """Of a bag: the topic and the joint whose fields the columns are."""

    topic: str = Field(pattern=r"^/[^\s:]{0,250}$")
    joint: str | None = Field(default=None, min_length=1, max_length=200)
    """One of those that a JointState or a DynamicJointState lists."""


class TextFormat(_Part):
    """How a text file is laid out, where that is not seen from the file itself."""

    delimiter: Literal["comma", "semicolon", "tab", "space"] | None = None
    decimal: Literal[".", ","] | None = None
    header: bool | None = None
    """Whether the first line holds the names."""
    skip: int = Field(default=0, ge=0, le=10_000)
    """Lines to leave out before that."""
    sheet: str | None = Field(default=None, min_length=1, max_length=200)
    """Of a workbook; the first where not given."""


class RigMap(_Part):
    """A map: the columns, the axis, the part of the time that is wanted."""

    name: str = Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")
    axis: Literal["linear", "rotary", "actuator"]
    description: str = Field(default="", max_length=1000)
    pole_pairs: int | None = Field(default=None, ge=1, le=200)
    """Of a motor that turns with the axis: a current sensor then shows once and twice these."""
    format: TextFormat = TextFormat()
    bag: BagSource | None = None
    """Where the file is a bag of ROS 2."""
    time: TimeColumn
    run: RunColumn | None = None
    """Where a file holds several runs; a time that starts again is a new run without it."""
    input: InputColumn | None = None
    position: Column | None = None
    speed: Column | None = None
    output_position: Column | None = None
    """Behind the gear or the coupling; `scale` turns it into motion of `position`'s side."""
    reference_position: Column | None = None
    reference_speed: Column | None = None
    disturbance: Column | None = None
    """Known force or torque from outside, positive where it helps the input."""
    channels: dict[str, Column] = Field(default_factory=dict, max_length=20)
    """With ``axis: actuator``: channels of the built-in test, those that there are, but time."""
    profile: str = Field(default="extended", max_length=4096)
    """With ``axis: actuator``: the test profile."""
    serial_number: str = Field(default=UNKNOWN_SERIAL, min_length=1, max_length=200)
    """With ``axis: actuator``: of the unit; a baseline and `ema trend` go by it."""
    bus_voltage: Positive | None = None
    """With ``axis: actuator``: between the rails during the test (V); the nominal one without."""
    winding_temperature: Annotated[float, Field(ge=-90.0, le=250.0)] | None = None
    """With ``axis: actuator``: during the test (degC); 20 without it."""
    start: Finite | None = None
    """First time to take (s), as the file counts it after conversion."""
    end: Finite | None = None
    duplicates: Literal["drop", "mean"] | None = None
    """What is done with rows of one time stamp."""
    mixed_rates: bool = False
    """Cells are empty where their column was not sampled; each column is taken by itself."""

    @property
    def roles(self) -> dict[str, Column]:
        """The columns of a rig that are given, of `RIG_COLUMNS`."""
        return {name: part for name in RIG_COLUMNS if (part := getattr(self, name)) is not None}

    @model_validator(mode="after")
    def _fits_the_axis(self) -> RigMap:
        if self.axis == "actuator":
            if self.roles:
                raise ValueError(f"{next(iter(self.roles))!r} is for a rig; an actuator has "
                                 "'channels'")
            extra = [name for name in self.channels if name not in CHANNEL_NAMES[1:]]
            if extra:
                raise ValueError(f"'channels' has the unknown {extra[0]!r}; an actuator has "
                                 f"{', '.join(CHANNEL_NAMES[1:])}")
            missing = what_lacks(
                [TIME, *(CHANNEL_NAMES.index(name) for name in self.channels)])
            if missing:
                raise ValueError(f"'channels' lacks {missing!r}: motor_speed and two phase "
                                 "currents must be there")
        else:
            if self.channels:
                raise ValueError("'channels' is for 'axis: actuator'; a rig has 'input', "
                                 "'position', 'speed'")
            if given := sorted(self.model_fields_set & OF_THE_ACTUATOR):
                raise ValueError(f"{given[0]!r} is for 'axis: actuator'")
            if self.input is None:
                raise ValueError("'input' is missing: the column of what drives the axis")
            if self.position is None and self.speed is None:
                raise ValueError("give 'position' or 'speed', or both")
            if self.output_position is not None and self.position is None:
                raise ValueError("'output_position' is compared with 'position': give both, or "
                                 "one sensor as 'position'")
        if self.pole_pairs is not None and self.axis != "rotary":
            raise ValueError("'pole_pairs' is for a rotary axis, whose motor turns with it")
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise ValueError(f"'end' {self.end:g} s is not after 'start' {self.start:g} s")
        return self


def load_map(path: str | Path) -> RigMap:
    """Return the map in a file.

    Raises
    ------
    UsageError
        The file cannot be read or is no map; one line says where and why.
    """
    return map_from(load_yaml(Path(path)), str(path))


def map_from(data: object, where: str) -> RigMap:
    """Validate `data` (as read from YAML); `where` names its origin in errors."""
    if not isinstance(data, dict):
        raise UsageError(f"{where}: expected 'name:', 'axis:', 'time:', 'input:' and so on: {SEE}")
    return validated(RigMap.model_validate, data, where, "map", SEE)
