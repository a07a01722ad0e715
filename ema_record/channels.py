"""The channels of `/ema/samples`: names, units, order, and which of them must be there.

A sample is the mean over its interval, or one instant of it, as the kit's acquisition says;
sample k covers ``[k, k + 1] / rate``. A recorder may lack any channel but those of `REQUIRED` and
two phase currents; what it lacks is NaN throughout a record.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ema_record.errors import InvalidRecordError, library


class Channel(NamedTuple):
    """One column of the acquisition."""

    name: str
    unit: str

    @property
    def label(self) -> str:
        """Name and unit as they stand in a message, e.g. ``motor_speed[rad/s]``."""
        return f"{self.name}[{self.unit}]"


CHANNELS: tuple[Channel, ...] = (
    Channel("time", "s"),
    Channel("motor_speed", "rad/s"),
    Channel("phase_current_a", "A"),
    Channel("phase_current_b", "A"),
    Channel("phase_current_c", "A"),
    Channel("reference_current_a", "A"),
    Channel("reference_current_b", "A"),
    Channel("reference_current_c", "A"),
    Channel("rotor_angle", "rad"),
    Channel("surface_position", "rad"),
)

N_CHANNELS = len(CHANNELS)
CHANNEL_NAMES: tuple[str, ...] = tuple(c.name for c in CHANNELS)
CHANNEL_LABEL: str = ",".join(c.label for c in CHANNELS)
ALL: tuple[int, ...] = tuple(range(N_CHANNELS))

TIME = 0
MOTOR_SPEED = 1
PHASE_CURRENTS = slice(2, 5)
REFERENCE_CURRENTS = slice(5, 8)
ROTOR_ANGLE = 8
SURFACE_POSITION = 9

REQUIRED = (TIME, MOTOR_SPEED)
"""Channels without which there is no record."""
LEAST_CURRENTS = 2
"""Phase currents without which there is no record."""
_CURRENTS = frozenset(ALL[PHASE_CURRENTS])


def label_of(columns: tuple[int, ...]) -> str:
    """Return the label of a message that holds these columns."""
    return ",".join(CHANNELS[column].label for column in columns)


@lru_cache(maxsize=64)
def columns_of(label: str) -> tuple[int, ...]:
    """Return the column of `CHANNELS` of each channel that a label names, in its order.

    Raises
    ------
    InvalidRecordError
        A channel is not known, is of another unit, comes twice or comes too late; or one is
        missing that must be there.
    """
    columns: list[int] = []
    known = {channel.label: column for column, channel in enumerate(CHANNELS)}
    for index, found in enumerate(label.split(",")):
        column = known.get(found)
        if column is None:
            raise _unknown(index, found)
        if columns and column <= columns[-1]:
            raise InvalidRecordError(
                f"/ema/samples: channel {index} is {found!r}, after "
                f"{CHANNELS[columns[-1]].name}: keep the order of the channel list, each once"
            )
        columns.append(column)
    missing = what_lacks(columns)
    if missing:
        raise InvalidRecordError(
            f"/ema/samples: no channel {missing}: time, motor speed and two phase currents must "
            "be there; record them too"
        )
    return tuple(columns)


def _unknown(index: int, found: str) -> InvalidRecordError:
    """Return the error for a channel that is not in the list, or not in that unit."""
    unit = next((c.unit for c in CHANNELS if c.name == found.partition("[")[0]), None)
    expected = "none of the channel list" if unit is None else f"expected in [{unit}]"
    return InvalidRecordError(
        f"/ema/samples: channel {index} is {found[:60]!r}, {expected}: record with an "
        "acquisition that publishes the channels of this version, or convert the file with "
        "'ema import'"
    )


def what_lacks(columns: list[int] | tuple[int, ...]) -> str:
    """Return which channel that a record must have is not among `columns`; empty: none."""
    for column in REQUIRED:
        if column not in columns:
            return CHANNELS[column].name
    if len(_CURRENTS.intersection(columns)) < LEAST_CURRENTS:
        return next(CHANNELS[k].name for k in sorted(_CURRENTS) if k not in columns)
    return ""


def recorded_columns(samples: np.ndarray) -> tuple[int, ...]:
    """Return the columns of samples, shape (n, 10), that were recorded.

    A column of NaN alone was not, unless a record must have it.
    """
    absent = [c for c in ALL if len(samples) and bool(np.isnan(samples[:, c]).all())]
    present = [c for c in ALL if c not in absent]
    needed = {*REQUIRED, *(sorted(_CURRENTS) if what_lacks(present) else ())}
    return tuple(c for c in ALL if c in present or c in needed)


def channels_to_pandas(
    samples: np.ndarray, channels: Sequence[Channel], attributes: dict[str, Any]
) -> Any:
    """Return samples, shape (n, m), as a DataFrame over the first channel, the time.

    Columns are named ``name[unit]``; `attributes` are in ``attrs``.
    """
    pandas = library("pandas", "to_pandas", "use the arrays of channel()")
    frame = pandas.DataFrame(samples[:, 1:], columns=[c.label for c in channels[1:]],
                             index=pandas.Index(samples[:, 0], name=channels[0].label))
    frame.attrs.update(attributes)
    return frame


def channels_to_xarray(
    samples: np.ndarray, channels: Sequence[Channel], attributes: dict[str, Any]
) -> Any:
    """Return samples, shape (n, m), as a Dataset over the time; each variable has its unit."""
    xarray = library("xarray", "to_xarray", "use to_pandas()")
    time, *others = channels
    return xarray.Dataset(
        {c.name: (time.name, samples[:, k], {"units": c.unit})
         for k, c in enumerate(others, start=1)},
        coords={time.name: (time.name, samples[:, 0], {"units": time.unit})}, attrs=attributes,
    )


def median(values: Any, axis: int | None = None) -> Any:
    """Return the median of all values, or along the last axis (-1), as `np.median` gives it.

    That one loads `numpy.ma`, which takes longer than a check needs for all of its medians.
    """
    given = np.asarray(values)
    if axis is None:
        given = given.ravel()
    n = given.shape[-1]
    if not n:
        return np.median(given, axis=-1)
    middle = [n // 2] if n % 2 else [n // 2 - 1, n // 2]
    parted = np.partition(given, [*middle, n - 1], axis=-1)
    found = parted[..., middle[0]:n // 2 + 1].mean(axis=-1)
    last = parted[..., -1]  # where NaN is sorted to
    return np.where(np.isnan(last), last, found) if found.ndim else (
        last if np.isnan(last) else found)


def measured(readings: np.ndarray) -> np.ndarray:
    """Return the readings, rows or numbers, that were measured: NaN stands for one that was not.

    So says sensor_msgs/BatteryState of its voltage and current.
    """
    absent = np.isnan(readings)
    return readings[~(absent if absent.ndim == 1 else absent.any(axis=1))]


TOLD = 10.0
"""Standard errors of a slope from which it is told: by chance one of 470 is, of five readings
(Student's t), the fewest in a test of the default kit."""
LEAST_POWER = 1e-6
"""Sum of the squares of a bus current (A2), about its mean, below which it is constant."""


def fall_of_bus(bus: np.ndarray) -> float:
    """Return by how much the bus voltage falls a bus current (V/A); 0 where that is not told.

    Where the current hardly varies the noise of a voltmeter makes any slope.

    Parameters
    ----------
    bus : ndarray, shape (n, 3), as `Record.dc_bus`.
    """
    bus = measured(bus)
    freedom = len(bus) - 2
    voltage, current = (bus[:, k] - bus[:, k].mean() if len(bus) else bus[:, k] for k in (1, 2))
    power = float(current @ current)
    if freedom < 1 or power < LEAST_POWER:
        return 0.0
    slope = -float(voltage @ current) / power
    rest = voltage + slope * current
    error = float(np.sqrt(rest @ rest / freedom / power))
    return slope if abs(slope) > TOLD * error else 0.0
