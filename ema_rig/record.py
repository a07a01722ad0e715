"""`RigRecord`: what was measured on a rig with one axis, and what the axis is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ema_record.channels import Channel, channels_to_pandas, channels_to_xarray
from ema_record.errors import InvalidRecordError, UsageError, unknown_name, validated
from ema_record.record import html_of

Motion = Literal["linear", "rotary"]
InputQuantity = Literal["voltage", "current", "force", "torque"]

LOAD_QUANTITY: dict[str, InputQuantity] = {"linear": "force", "rotary": "torque"}
INPUT_UNITS: dict[InputQuantity, str] = {
    "voltage": "V", "current": "A", "force": "N", "torque": "N m"}

TIME = "time"
POSITION = "position"
SPEED = "speed"
OUTPUT_POSITION = "output_position"
REFERENCE_POSITION = "reference_position"
REFERENCE_SPEED = "reference_speed"
DISTURBANCE = "disturbance"

MAX_RIG_SAMPLES = 5_000_000
"""Most samples of a rig's record."""
MAX_RIG_DURATION, MAX_RIG_RATE = 86_400.0, 2e5
"""Longest record of a rig (s), and most samples a second."""


class Axis(BaseModel):
    """What one axis is: how it moves, what drives it, where the record comes from."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")
    motion: Motion
    input: InputQuantity
    description: str = Field(default="", max_length=1000)
    pole_pairs: int | None = Field(default=None, ge=1, le=200)
    """Of the motor, where it turns with the axis and they are known."""
    notes: tuple[str, ...] = Field(default=(), max_length=50)
    """What was done to the numbers when they were imported."""

    @property
    def input_channel(self) -> Channel:
        """Channel of the input, e.g. ``input_force[N]``."""
        return Channel(f"input_{self.input}", INPUT_UNITS[self.input])

    @property
    def position_unit(self) -> str:
        """``m`` or ``rad``."""
        return "m" if self.motion == "linear" else "rad"

    @property
    def speed_unit(self) -> str:
        """``m/s`` or ``rad/s``."""
        return f"{self.position_unit}/s"

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels that a record of this axis may have, in their order."""
        position, speed = self.position_unit, self.speed_unit
        return (
            Channel(TIME, "s"), self.input_channel, Channel(POSITION, position),
            Channel(SPEED, speed), Channel(OUTPUT_POSITION, position),
            Channel(REFERENCE_POSITION, position), Channel(REFERENCE_SPEED, speed),
            Channel(DISTURBANCE, INPUT_UNITS[LOAD_QUANTITY[self.motion]]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RigRecord:
    """One recording of a rig.

    Attributes
    ----------
    samples : ndarray, shape (n, m). One row a sample, columns as in `channels`, SI units; time
        increases.
    channels : some of `Axis.channels`, in that order: time, the input, position or speed at least.
    axis : what the axis is.
    source : file or bag that it was read from.

    Raises
    ------
    UsageError, InvalidRecordError
        Shape, channels or values are wrong; the first sample that is wrong is named.
    """

    samples: np.ndarray
    channels: tuple[Channel, ...]
    axis: Axis
    source: str = ""

    def __post_init__(self) -> None:
        if self.samples.ndim != 2 or self.samples.shape[1] != len(self.channels):
            raise UsageError(
                f"samples have shape {self.samples.shape}, expected (n, {len(self.channels)}): "
                "give one row a sample"
            )
        _check_channels(self.channels, self.axis, self.source or "record")
        _check_samples(self.samples, self.channels, self.source or "record")

    def __len__(self) -> int:
        return len(self.samples)

    def has(self, name: str) -> bool:
        """Return whether the record has the channel `name`."""
        return any(channel.name == name for channel in self.channels)

    def channel(self, name: str) -> np.ndarray:
        """Return one channel, shape (n,), SI."""
        names = [channel.name for channel in self.channels]
        if name not in names:
            raise UsageError(f"{self.source or 'record'}: no channel {name!r}; it has "
                             f"{', '.join(names)}: name its column in the map")
        return self.samples[:, names.index(name)]

    @property
    def time(self) -> np.ndarray:
        """Time, shape (n,) (s)."""
        return self.samples[:, 0]

    @property
    def input(self) -> np.ndarray:
        """Input of the axis, shape (n,), in the unit of `Axis.input_channel`."""
        return self.samples[:, 1]

    @property
    def rate(self) -> float:
        """Sampling rate from the mean interval of the quarters around the median (1/s)."""
        steps = np.diff(self.time)
        low, high = np.quantile(steps, [0.25, 0.75])
        return float(1.0 / steps[(steps >= low) & (steps <= high)].mean())

    @property
    def duration(self) -> float:
        """Length of the record (s)."""
        return float(self.time[-1] - self.time[0])

    def _facts(self) -> dict[str, Any]:
        """Return what the record is of, in plain values."""
        return {"axis": self.axis.name, "motion": self.axis.motion, "input": self.axis.input,
                "source": self.source}

    def __repr__(self) -> str:
        return f"<RigRecord {self.axis.name}: {len(self)} samples in {self.duration:.4g} s>"

    def _repr_html_(self) -> str:
        names = ", ".join(c.label for c in self.channels)
        size = (("samples", len(self)), ("duration (s)", f"{self.duration:.4g}"))
        return html_of("RigRecord", (*self._facts().items(), *size, ("channels", names)))

    def to_pandas(self) -> Any:
        """Return the channels as a DataFrame over the time, columns ``name[unit]``."""
        return channels_to_pandas(self.samples, self.channels, self._facts())

    def to_xarray(self) -> Any:
        """Return the channels as an xarray Dataset over the time."""
        return channels_to_xarray(self.samples, self.channels, self._facts())


def _check_channels(channels: tuple[Channel, ...], axis: Axis, source: str) -> None:
    """Check that time, input and an output are there, known and in order."""
    known = axis.channels
    for channel in channels:
        if channel not in known:
            raise InvalidRecordError(
                f"{source}: channel {channel.label[:60]!r} is unknown for a {axis.motion} axis "
                f"with a {axis.input} input; known are {', '.join(k.label for k in known)}: "
                "convert the file with 'ema import'"
            )
    if list(channels) != [k for k in known if k in channels]:
        raise InvalidRecordError(
            f"{source}: channels {', '.join(c.label for c in channels)} are repeated or out of "
            "order: convert the file with 'ema import'"
        )
    for needed in known[:2]:
        if needed not in channels:
            raise InvalidRecordError(
                f"{source}: no channel {needed.label}: name its column in the map"
            )
    if not {POSITION, SPEED} & {channel.name for channel in channels}:
        raise InvalidRecordError(
            f"{source}: neither position nor speed: name a column of one of them in the map"
        )


def _check_samples(samples: np.ndarray, channels: tuple[Channel, ...], source: str) -> None:
    """Check that the values are finite, that time increases, and the bounds of the length."""
    if not 2 <= len(samples) <= MAX_RIG_SAMPLES:
        raise InvalidRecordError(
            f"{source}: {len(samples)} samples, expected 2 to {MAX_RIG_SAMPLES}: record longer, "
            "or import a part with 'start' and 'end' in the map"
        )
    finite = np.isfinite(samples)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        raise InvalidRecordError(
            f"{source}: sample {row} of {channels[column].name} is {samples[row, column]}: every "
            "value must be finite"
        )
    steps = np.diff(samples[:, 0])
    if steps.min() <= 0.0:
        row = int(np.argmax(steps <= 0.0)) + 1
        raise InvalidRecordError(
            f"{source}: time does not increase at sample {row}: {samples[row, 0]:.9g} s after "
            f"{samples[row - 1, 0]:.9g} s: choose the right column or unit of time, or import a "
            "part with 'start' and 'end' in the map"
        )
    if samples[-1, 0] - samples[0, 0] > MAX_RIG_DURATION:
        raise InvalidRecordError(
            f"{source}: {samples[-1, 0] - samples[0, 0]:.3g} s long, at most "
            f"{MAX_RIG_DURATION:g} s: check the unit of time in the map"
        )
    if (rate := float(1.0 / np.median(steps))) > MAX_RIG_RATE:
        raise InvalidRecordError(
            f"{source}: {rate:.3g} samples a second, at most {MAX_RIG_RATE:g}: check the unit of "
            "time in the map"
        )


def rig_record(values: Mapping[str, Any], motion: Motion, name: str) -> RigRecord:
    """Return a record of arrays, shape (n,), SI, by the names of their channels.

    Raises
    ------
    UsageError, InvalidRecordError
        A channel that does not exist or lacks, or values that cannot be used.
    """
    given = {str(key): np.asarray(values[key], dtype=np.float64) for key in values}
    inputs = [quantity for quantity in INPUT_UNITS if f"input_{quantity}" in given]
    if len(inputs) != 1:
        raise UsageError(f"{len(inputs)} inputs among {', '.join(given)[:80]}: give one of "
                         f"{', '.join(f'input_{quantity}' for quantity in INPUT_UNITS)}")
    axis = validated(Axis.model_validate, {"name": name, "motion": motion, "input": inputs[0]},
                     "rig", "axis", "see docs/rigs.md")
    known = {channel.name: channel for channel in axis.channels}
    for key in given:
        if key not in known:
            raise unknown_name("channel", key, known, f"a rig has {', '.join(known)}")
    shapes = {array.shape for array in given.values()}
    if len(shapes) > 1 or len(next(iter(shapes))) != 1:
        raise UsageError(f"channels of shapes {', '.join(map(str, sorted(shapes)))}: give each "
                         "one value a sample")
    kept = [key for key in known if key in given]
    return RigRecord(samples=np.column_stack([given[key] for key in kept]), axis=axis,
                     channels=tuple(known[key] for key in kept), source=name)
