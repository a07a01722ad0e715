"""`import_file`: a foreign file and its map become a record, of a rig or of our actuator."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import numpy as np

from ema_record.channels import CHANNELS, N_CHANNELS, Channel
from ema_record.errors import InvalidRecordError, UsageError
from ema_record.profile import load_profile
from ema_record.record import Provenance, Record, check_samples
from ema_record.version import VERSION
from ema_rig.map import Column, InputColumn, RigMap, TextFormat
from ema_rig.mat import read_mat
from ema_rig.npz import read_npz
from ema_rig.record import INPUT_UNITS, Axis, InputQuantity, RigRecord
from ema_rig.runs import chosen_runs, one_after_another, restarts
from ema_rig.table import MAX_FILE_BYTES, Table
from ema_rig.text import read_text_table
from ema_rig.units import SI_OF, unit_factor

SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".mat", ".npz", ".gz")
GAP = 5.0
"""An interval of so many median intervals is a gap."""
MAX_LOST = 0.05
"""Largest share of rows that may be left out because a value is missing."""
_QUANTITY_OF = {unit: quantity for quantity, unit in SI_OF.items()}


def import_file(path: str | Path, rig_map: RigMap) -> RigRecord | Record:
    """Return what a CSV, TXT, MAT or NPZ file holds, in SI units.

    Parameters
    ----------
    path : path-like
        The file.
    rig_map : RigMap
        Which column is what.

    Returns
    -------
    RigRecord or Record
        A `Record` where the map says ``axis: actuator``. What was done to the numbers is in
        `Axis.notes` of a rig.

    Raises
    ------
    InvalidRecordError, UsageError
        Damaged, too large, a column is missing or its unit wrong, time does not increase.

    """
    source = str(path)
    if rig_map.axis == "actuator":
        return _actuator(rig_map, Path(path))
    assert rig_map.input is not None  # the map says so
    needed = [part.column for part in _columns(rig_map).values()]
    if isinstance(rig_map.input.gain, str):
        needed.append(rig_map.input.gain)
    table = _table(rig_map, Path(path), needed)
    quantity = rig_map.input.acts_as or _quantity(rig_map.input, source)
    axis = Axis(name=rig_map.name, motion=rig_map.axis, input=quantity,
                description=rig_map.description)
    notes = list(table.notes)
    given = {channel.name: channel for channel in axis.channels}
    columns: dict[str, np.ndarray] = {}
    for name, part in _columns(rig_map).items():
        channel = given[axis.input_channel.name if name == "input" else name]
        if isinstance(part, InputColumn):
            columns[channel.name] = _input(table, part, quantity)
        else:
            columns[channel.name] = _converted(table, part, name, _QUANTITY_OF[channel.unit])
    samples, chosen = _joined(table, rig_map, columns, axis.channels, notes)
    axis = axis.model_copy(update={"notes": tuple(notes)})
    return RigRecord(samples=samples, channels=chosen, axis=axis, source=source)


def _columns(rig_map: RigMap) -> dict[str, Column]:
    names = ("input", "position", "speed", "reference_position", "reference_speed", "disturbance")
    return {name: part for name in names if (part := getattr(rig_map, name)) is not None}


def _table(rig_map: RigMap, path: Path, needed: list[str | int]) -> Table:
    if rig_map.time.column is not None:
        needed = [rig_map.time.column, *needed]
    if rig_map.run is not None:
        needed = [rig_map.run.column, *needed]
    return read_table(path, rig_map.format, needed)


def read_table(path: Path, text_format: TextFormat, needed: Sequence[str | int]) -> Table:
    """Return the columns of a CSV, TXT, MAT (v5) or NPZ file.

    Parameters
    ----------
    path : Path
        Known by its suffix; text may be compressed by gzip.
    text_format : TextFormat
        How text is laid out, where that is known.
    needed : sequence of str or int
        Columns that are wanted; a MAT or NPZ file is read no further.

    Raises
    ------
    InvalidRecordError
        Damaged, too large, or of a kind that cannot be read safely.
    UsageError
        Not one of these kinds, or not there.

    """
    if not path.is_file():
        raise UsageError(f"{path}: no such file: give a CSV, TXT, MAT or NPZ file")
    size = path.stat().st_size
    if not 0 < size <= MAX_FILE_BYTES:
        raise InvalidRecordError(f"{path}: {size} bytes, expected 1 to {MAX_FILE_BYTES}: "
                                 "import a part of it")
    suffix = path.suffix.lower()
    if suffix == ".mat":
        return read_mat(path, needed)
    if suffix == ".npz":
        return read_npz(path, needed)
    if suffix not in SUFFIXES:
        raise UsageError(f"{path}: a file {suffix or 'without suffix'!r} is not known: give one "
                         f"of {', '.join(SUFFIXES)}")
    return read_text_table(path, text_format)


def _quantity(part: Column, source: str) -> InputQuantity:
    """Return what the input is, by its unit."""
    for quantity in get_args(InputQuantity):
        try:
            unit_factor(part.unit, quantity, source)
        except UsageError:
            continue
        found: InputQuantity = quantity
        return found
    raise UsageError(f"{source}: input: unit {part.unit!r} measures none of "
                     f"{', '.join(INPUT_UNITS)}: correct it in the map")


def _converted(table: Table, part: Column, name: str, quantity: str) -> np.ndarray:
    """Return a column in SI, shape (n,)."""
    factor = unit_factor(part.unit, quantity, f"{table.source}: {name}")
    return (table.column(part.column, name) - part.zero) * (factor * part.scale)


def _input(table: Table, part: InputColumn, quantity: str) -> np.ndarray:
    """Return the input, turned into what it acts as."""
    if part.gain is None:
        return _converted(table, part, "input", quantity)
    own = _quantity(part, table.source)
    gain = part.gain if isinstance(part.gain, float | int) else table.scalar(part.gain, "gain")
    if gain == 0.0:
        raise UsageError(f"{table.source}: input: gain is 0: give {INPUT_UNITS[quantity]} a "
                         f"{INPUT_UNITS[own]}")
    return _converted(table, part, "input", own) * float(gain)


def _joined(
    table: Table, rig_map: RigMap, columns: dict[str, np.ndarray],
    channels: tuple[Channel, ...], notes: list[str],
) -> tuple[np.ndarray, tuple[Channel, ...]]:
    """Return all columns with time in front, within the bounds of time, and their channels."""
    source = table.source
    lengths = {name: len(values) for name, values in columns.items()}
    length = next(iter(lengths.values()))
    if rig_map.time.column is None:
        assert rig_map.time.rate is not None
        time = np.arange(length) / rig_map.time.rate
    else:
        factor = unit_factor(rig_map.time.unit, "time", f"{source}: time")
        time = table.column(rig_map.time.column, "time") * factor
    lengths["time"] = len(time)
    if len(set(lengths.values())) != 1:
        raise InvalidRecordError(f"{source}: columns of different length: "
                                 + ", ".join(f"{k} {n}" for k, n in lengths.items()))
    chosen = tuple(c for c in channels if c.name == "time" or c.name in columns)
    ordered = [time if c.name == "time" else columns[c.name] for c in chosen]
    samples = np.column_stack(ordered)
    labels = restarts(time) if rig_map.run is None else table.column(rig_map.run.column, "run")
    if len(labels) != len(time):
        raise InvalidRecordError(f"{source}: columns of different length: time {len(time)}, run "
                                 f"{len(labels)}")
    if rig_map.run is not None:
        inside = chosen_runs(labels, rig_map.run.only, source)
        samples, time, labels = samples[inside], time[inside], labels[inside]
    if rig_map.start is not None or rig_map.end is not None:
        low = -np.inf if rig_map.start is None else rig_map.start
        high = np.inf if rig_map.end is None else rig_map.end
        inside = (time >= low) & (time <= high)
        if inside.sum() < 2:
            raise UsageError(f"{source}: {inside.sum()} samples between start {low:g} s and end "
                             f"{high:g} s; the file runs from {time[0]:g} to {time[-1]:g} s")
        samples, labels = samples[inside], labels[inside]
        notes.append(f"{inside.sum()} of {len(time)} samples, from {samples[0, 0]:g} to "
                     f"{samples[-1, 0]:g} s")
    samples, labels = _without_missing(samples, labels, source, notes)
    samples[:, 0], told = one_after_another(samples[:, 0], labels, source)
    notes += told
    _describe_time(samples[:, 0], notes)
    return samples, chosen


def _without_missing(
    samples: np.ndarray, labels: np.ndarray, source: str, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Leave out rows with a value that is missing, if they are few."""
    bad = ~np.isfinite(samples).all(axis=1)
    if bad.mean() > MAX_LOST:
        raise InvalidRecordError(
            f"{source}: {bad.sum()} of {len(bad)} rows lack a value, at most "
            f"{100 * MAX_LOST:g} %: choose other columns, or a part with 'start' and 'end'"
        )
    if bad.any():
        notes.append(f"{bad.sum()} rows without a value left out")
    return samples[~bad], labels[~bad]


def _describe_time(time: np.ndarray, notes: list[str]) -> None:
    """Say what is irregular about the sampling; nothing is changed."""
    steps = np.diff(time)
    if len(steps) == 0 or steps.min() <= 0.0:
        return  # refused by the record itself, with the row
    median = float(np.median(steps))
    gaps = steps[steps > GAP * median]
    if len(gaps):
        notes.append(f"{len(gaps)} gap(s) in time of more than {GAP:g} intervals, the longest "
                     f"{gaps.max():.3g} s")
    spread = float(np.quantile(np.abs(steps - median), 0.99) / median)
    if spread > 0.01:
        notes.append(f"irregular sampling: 1 % of the intervals differ from the median "
                     f"{median:.4g} s by more than {100 * spread:.0f} %")


def _actuator(rig_map: RigMap, path: Path) -> Record:
    """Return the record of our actuator's own test."""
    table = _table(rig_map, path, [part.column for part in rig_map.channels.values()])
    notes: list[str] = []
    columns = {
        channel.name: _converted(
            table, rig_map.channels[channel.name], channel.name, _QUANTITY_OF[channel.unit])
        for channel in CHANNELS[1:] if channel.name in rig_map.channels
    }
    recorded, chosen = _joined(table, rig_map, columns, CHANNELS, notes)
    samples = np.full((len(recorded), N_CHANNELS), np.nan)
    samples[:, [CHANNELS.index(channel) for channel in chosen]] = recorded
    check_samples(samples, str(path))
    return Record(
        samples=samples, profile=load_profile(rig_map.profile),
        provenance=Provenance(software_version=VERSION, source=str(path)),
    )
