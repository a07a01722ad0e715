"""`Record`: one built-in test as arrays, with its profile and its provenance."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from html import escape
from typing import Any, Literal, NamedTuple

import numpy as np

from ema_record.channels import (
    CHANNEL_NAMES,
    CHANNELS,
    N_CHANNELS,
    TIME,
    Channel,
    channels_to_pandas,
    channels_to_xarray,
    median,
    recorded_columns,
)
from ema_record.errors import InvalidRecordError, UsageError, unknown_name
from ema_record.limits import MAX_DURATION, MAX_RATE
from ema_record.profile import Profile

Status = Literal["complete", "aborted", "interrupted"]
SETTLING = 1e-3
"""Until the currents of the test before have gone once the inverter is off, and before it drives
again (s): a coil gives its energy back through the diodes within L I / U, some 0.1 ms."""
LARGEST_STEP = 1.5
"""Longest step of time, in sample intervals, after which no sample is missing."""
UNKNOWN_SERIAL = "unknown"
"""Serial number of an actuator of which none is known; so is an empty one."""


def known_serial(serial_number: str) -> str:
    """Return a serial number, empty where it says that it is not known."""
    return "" if serial_number == UNKNOWN_SERIAL else serial_number


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Where a record comes from. Never tells which effect was injected."""

    serial_number: str = UNKNOWN_SERIAL
    """Serial number of the actuator."""
    software_version: str = "unknown"
    """Version of the software that recorded."""
    start_time: int = 0
    """Acceptance of the command (ns since the epoch), 0 if not known."""
    status: Status = "complete"
    """How the test ended."""
    source: str = ""
    """File or bag that it was read from."""
    actuator: str = ""
    """Type of the actuator, see `actuator_type`; empty: not known."""
    namespace: str = ""
    """Of the actuator on the graph it was recorded from, ``/left_aileron``; empty: it has none."""

    @property
    def known_serial(self) -> str:
        """Serial number, empty where it is not known."""
        return known_serial(self.serial_number)

    @property
    def name(self) -> str:
        """Name of the actuator among others of the aircraft, ``left_aileron``; empty: none."""
        return self.namespace.removeprefix("/")


class SampleBlock(NamedTuple):
    """One message of samples."""

    log_time: int
    """Reception (ns since the epoch)."""
    samples: np.ndarray
    """Shape (k, 10)."""


def _empty(columns: int) -> np.ndarray:
    return np.empty((0, columns))


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """One built-in test.

    Attributes
    ----------
    samples : ndarray, shape (n, 10). One row a sample, columns as in `channels.CHANNELS`; NaN
        throughout where the recorder lacks a channel.
    profile : the position command.
    provenance : serial number, versions, status.
    dc_bus : ndarray, shape (m, 3). Time (s), bus voltage (V), bus current (A), positive into the
        drive.
    winding_temperature : ndarray, shape (m, 2). Time (s), temperature (degC).
    """

    samples: np.ndarray
    profile: Profile
    provenance: Provenance = field(default_factory=Provenance)
    dc_bus: np.ndarray = field(default_factory=lambda: _empty(3))
    winding_temperature: np.ndarray = field(default_factory=lambda: _empty(2))

    def __post_init__(self) -> None:
        """Take the arrays as plain numbers, what is masked as NaN, and check the shapes."""
        for name in ("samples", "dc_bus", "winding_temperature"):
            object.__setattr__(self, name, _numbers(getattr(self, name), name))
        for name, columns in (("dc_bus", 3), ("winding_temperature", 2)):
            shape = getattr(self, name).shape
            if len(shape) != 2 or shape[1] != columns:
                raise UsageError(f"{name} has shape {shape}, expected (m, {columns})")
        if self.samples.ndim != 2 or self.samples.shape[1] != N_CHANNELS:
            raise UsageError(
                f"samples have shape {self.samples.shape}, expected (n, {N_CHANNELS}): "
                "give one row a sample"
            )

    def __len__(self) -> int:
        return len(self.samples)

    @property
    def columns(self) -> tuple[int, ...]:
        """Return the columns that were recorded, in order."""
        return recorded_columns(self.samples)

    def channel(self, name: str) -> np.ndarray:
        """Return one channel, shape (n,), in the unit of `channels.CHANNELS`."""
        if name not in CHANNEL_NAMES:
            raise unknown_name("channel", name, CHANNEL_NAMES,
                               f"a record has {', '.join(CHANNEL_NAMES)}")
        return self.samples[:, CHANNEL_NAMES.index(name)]

    @property
    def time(self) -> np.ndarray:
        """Time since the acceptance of the command, shape (n,) (s)."""
        return self.samples[:, 0]

    @property
    def rate(self) -> float:
        """Return the sampling rate from the median interval, in 1/s; NaN below 2 samples."""
        if len(self) < 2:
            return float("nan")
        return float(1.0 / median(np.diff(self.time)))

    @property
    def at_rest(self) -> slice:
        """Samples in which nothing drives and no current flows: what the sensors read of it."""
        begin, end = np.searchsorted(
            self.time, (SETTLING, self.profile.inverter_off - SETTLING)).tolist()
        return slice(begin, max(begin, end))

    @property
    def duration(self) -> float:
        """Length of the record (s)."""
        return float(len(self) / self.rate) if len(self) > 1 else 0.0

    def _facts(self) -> dict[str, Any]:
        """Return what the record is of, in plain values."""
        known = self.provenance
        return {
            "serial_number": known.serial_number, "profile": self.profile.name,
            "start_time": iso_time(known.start_time) or "not known", "status": known.status,
            "source": known.source,
        }

    def __repr__(self) -> str:
        facts = self._facts()
        return (f"<Record {facts['serial_number']}, {facts['profile']}: {len(self)} samples in "
                f"{self.duration:.4g} s, {facts['status']}>")

    def _repr_html_(self) -> str:
        size = (("samples", len(self)), ("duration (s)", f"{self.duration:.4g}"))
        channels = ", ".join(CHANNELS[c].label for c in self.columns)
        return html_of("Record", (*self._facts().items(), *size, ("channels", channels)))

    def to_pandas(self) -> Any:
        """Return the recorded channels as a DataFrame over the time, columns ``name[unit]``."""
        return channels_to_pandas(*self._table(), self._facts())

    def to_xarray(self) -> Any:
        """Return the recorded channels as an xarray Dataset over the time."""
        return channels_to_xarray(*self._table(), self._facts())

    def _table(self) -> tuple[np.ndarray, list[Channel]]:
        return self.samples[:, list(self.columns)], [CHANNELS[c] for c in self.columns]


def _numbers(given: Any, name: str) -> np.ndarray:
    """Return an array as float64, the same one where it is; UsageError: it holds no numbers."""
    if type(given) is np.ndarray and given.dtype == np.float64:
        return given
    if np.iscomplexobj(given):
        raise UsageError(f"{name}: complex numbers: give real ones")
    try:
        return np.asarray(np.ma.filled(np.ma.asarray(given).astype(np.float64), np.nan))
    except (TypeError, ValueError):
        raise UsageError(f"{name}: no array of numbers") from None


def html_of(title: str, rows: Iterable[tuple[str, object]]) -> str:
    """Return a small table of names and values, ready for a notebook."""
    lines = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th>"
        f"<td style='text-align:left'>{escape(str(value))}</td></tr>" for name, value in rows
    )
    return f"<table><caption>{escape(title)}</caption>{lines}</table>"


def iso_time(start_time: int) -> str | None:
    """Return a time (ns since the epoch) as ISO 8601 in UTC, to the ms; None for 0."""
    if not start_time:
        return None
    time = datetime.fromtimestamp(start_time / 1e9, tz=timezone.utc)
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def check_samples(samples: np.ndarray, source: str) -> None:
    """Check that samples, shape (n, 10), are finite, in order of time, and within its bounds.

    A channel that a recorder may lack may be NaN throughout.

    Raises
    ------
    InvalidRecordError
        The first sample that is wrong is named.
    """
    finite = np.isfinite(samples)
    if not finite.all():
        finite[:, [c for c in range(N_CHANNELS) if c not in recorded_columns(samples)]] = True
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        raise InvalidRecordError(
            f"{source}: sample {row}, {CHANNEL_NAMES[column]} is {samples[row, column]}: every "
            "value must be finite; look at the transducer or its cable"
        )
    steps = np.diff(samples[:, TIME])
    if len(steps) and steps.min() <= 0.0:
        row = int(np.argmax(steps <= 0.0)) + 1
        raise InvalidRecordError(
            f"{source}: time does not increase at sample {row}: {samples[row, TIME]:.9g} s "
            f"after {samples[row - 1, TIME]:.9g} s: blocks were lost, repeated or mixed"
        )
    if len(steps) and steps.min() < 0.5 / MAX_RATE:
        raise InvalidRecordError(
            f"{source}: interval of {steps.min():.3g} s between samples, at least "
            f"{1.0 / MAX_RATE:g} s: check the time channel"
        )
    if samples[-1, TIME] - samples[0, TIME] > MAX_DURATION + 1.0:
        raise InvalidRecordError(
            f"{source}: {samples[-1, TIME] - samples[0, TIME]:.3g} s long, at most "
            f"{MAX_DURATION:g} s: a record holds one test"
        )


def unit_names(records: Sequence[Record]) -> list[str]:
    """Return of which unit each record is, by its serial number.

    One without a serial number counts as a unit: nothing says that two are of the same.
    """
    return [record.provenance.known_serial or f"{UNKNOWN_SERIAL} {k}"
            for k, record in enumerate(records)]
