"""`import_file`: a foreign file and its map become a record, of a rig or of our actuator."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ema_record.bag.any_topic import is_bag
from ema_record.channels import CHANNELS, N_CHANNELS, ROTOR_ANGLE, Channel
from ema_record.errors import InvalidRecordError, UsageError, counted
from ema_record.limits import MAX_DURATION
from ema_record.profile import load_profile
from ema_record.record import Provenance, Record, check_samples
from ema_record.version import VERSION
from ema_rig.array_files import read_mat, read_npz, read_parquet
from ema_rig.hdf5 import read_hdf5
from ema_rig.map import Column, InputColumn, RigMap, TextFormat
from ema_rig.record import INPUT_UNITS, Axis, InputQuantity, RigRecord
from ema_rig.ros_bag import read_ros_bag
from ema_rig.table import MAX_FILE_BYTES, Table
from ema_rig.text import read_text_table
from ema_rig.times import (
    CLOCK,
    ISO,
    chosen_runs,
    one_after_another,
    one_clock,
    restarts,
    run_labels,
    seconds,
    single_stamps,
    unwrapped,
)
from ema_rig.units import SI_OF, is_unit, unit_factor
from ema_rig.xlsx import read_xlsx

SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".log", ".mat", ".npz", ".parquet", ".xlsx", ".h5",
            ".hdf5", ".gz")
READERS = {".mat": read_mat, ".npz": read_npz, ".parquet": read_parquet,
           **dict.fromkeys((".h5", ".hdf5", ".hdf"), read_hdf5)}
ELSEWHERE = {
    **dict.fromkeys((".xls", ".ods", ".xlsb"), "this spreadsheet is not read: save it as XLSX or "
                    "as CSV (in the menu 'save as'), then import that file"),
    ".bag": "a bag of ROS 1 is not read: convert it with 'rosbags-convert'",
}
"""What is known and not read, and what to do with it."""
GAP = 5.0
"""An interval of so many median intervals is a gap."""
MAX_LOST = 0.05
"""Largest share of rows that may be left out because a value is missing."""
_QUANTITY_OF = {unit: quantity for quantity, unit in SI_OF.items()}


def import_file(
    path: str | Path, rig_map: RigMap, notes: list[str] | None = None
) -> RigRecord | Record:
    """Return what a bag or a file of another kind (`SUFFIXES`) holds, in SI units.

    Parameters
    ----------
    path : the file.
    rig_map : which column is what.
    notes : where given, what was done to the numbers is added to it.

    Returns
    -------
    RigRecord or Record
        A `Record` where the map says ``axis: actuator``. What was done to the numbers is in
        `Axis.notes` of a rig too.

    Raises
    ------
    InvalidRecordError, UsageError
        Damaged, too large, a column is missing or its unit wrong, time does not increase.
    """
    source = str(path)
    told = [] if notes is None else notes
    if rig_map.axis == "actuator":
        return _actuator(rig_map, Path(path), told)
    assert rig_map.input is not None  # the map says so
    table = _table(rig_map, Path(path), rig_map.roles.values())
    quantity = rig_map.input.acts_as or _quantity(rig_map.input, source)
    axis = Axis(name=rig_map.name, motion=rig_map.axis, input=quantity,
                description=rig_map.description, pole_pairs=rig_map.pole_pairs)
    told += table.notes
    given = {channel.name: channel for channel in axis.channels}
    columns: dict[str, np.ndarray] = {}
    parts: dict[str, Column] = {}
    for name, part in rig_map.roles.items():
        channel = given[axis.input_channel.name if name == "input" else name]
        parts[channel.name] = part
        columns[channel.name] = _input(table, part, quantity) if isinstance(
            part, InputColumn) else _converted(table, part, name, _QUANTITY_OF[channel.unit])
    samples, chosen = _joined(table, rig_map, columns, parts, axis.channels, told)
    axis = axis.model_copy(update={"notes": tuple(told)})
    return RigRecord(samples=samples, channels=chosen, axis=axis, source=source)


def _table(rig_map: RigMap, path: Path, parts: Iterable[Column]) -> Table:
    """Return the columns of a file that a map needs."""
    needed: list[str | int] = []
    for part in parts:
        needed += [part.column, *([] if part.time is None else [part.time.column])]
        if isinstance(part, InputColumn) and isinstance(part.gain, str):
            needed.append(part.gain)
    if rig_map.time.column is not None:
        needed.append(rig_map.time.column)
    if rig_map.run is not None:
        needed.append(rig_map.run.column)
    if rig_map.bag is not None:
        return read_ros_bag(path, rig_map.bag, needed)
    return read_table(path, rig_map.format, needed)


def read_table(path: Path, text_format: TextFormat, needed: Sequence[str | int] | None) -> Table:
    """Return the columns of a file that is no bag.

    Parameters
    ----------
    path : known by its suffix; text may be compressed by gzip.
    text_format : how text is laid out, where that is known.
    needed : columns that are wanted, all where None; a file is read no further.

    Raises
    ------
    InvalidRecordError
        Damaged, too large, or of a kind that cannot be read safely.
    UsageError
        Not one of these kinds, or not there.
    """
    if path.is_dir() or is_bag(path):
        raise UsageError(f"{path}: a bag of ROS 2 needs 'bag: {{topic: /joint_states, joint: ...}}"
                         "' in the map, or no map but --topic and --joint")
    if not path.is_file():
        raise UsageError(f"{path}: no such file: give a file or a bag that is there")
    size = path.stat().st_size
    if not 0 < size <= MAX_FILE_BYTES:
        raise InvalidRecordError(
            f"{path}: {size} bytes, expected 1 to {MAX_FILE_BYTES}: "
            f"{'import a part of it' if size else 'it is empty, save it again'}")
    suffix = path.suffix.lower()
    if suffix in READERS:
        return READERS[suffix](path, needed)
    if suffix in (".xlsx", ".xlsm"):
        return read_xlsx(path, text_format, needed)
    if suffix in ELSEWHERE:
        raise UsageError(f"{path}: {ELSEWHERE[suffix]}")
    if suffix not in SUFFIXES:
        raise UsageError(f"{path}: a file {suffix or 'without suffix'!r} is not known: give one "
                         f"of {', '.join(SUFFIXES)}, or a bag (.mcap, .db3, or its directory)")
    return read_text_table(path, text_format, needed)


def _quantity(part: Column, source: str) -> InputQuantity:
    """Return what the input is, by its unit."""
    for quantity in INPUT_UNITS:
        with contextlib.suppress(UsageError):
            unit_factor(part.unit, quantity, source)
            return quantity
    if not is_unit(part.unit):
        unit_factor(part.unit, "force", f"{source}: input")  # says which unit is near
    raise UsageError(f"{source}: input: unit {part.unit!r} measures none of "
                     f"{', '.join(INPUT_UNITS)}: correct it in the map")


def _converted(table: Table, part: Column, name: str, quantity: str) -> np.ndarray:
    """Return a column in SI, shape (n,)."""
    factor = unit_factor(part.unit, quantity, f"{table.source}: {name}")
    values = table.column(part.column, name)
    if part.unwrap is not None:
        values = unwrapped(values, part.unwrap)
    return (values - part.zero) * (factor * part.scale)


def _input(table: Table, part: InputColumn, quantity: InputQuantity) -> np.ndarray:
    """Return the input, turned into what it acts as."""
    if part.gain is None:
        return _converted(table, part, "input", quantity)
    own = _quantity(part, table.source)
    gain = part.gain if isinstance(part.gain, float | int) else table.scalar(part.gain, "gain")
    if gain == 0.0:
        raise UsageError(f"{table.source}: input: gain is 0: give {INPUT_UNITS[quantity]} a "
                         f"{INPUT_UNITS[own]}")
    return _converted(table, part, "input", own) * float(gain)


def _clocked(
    table: Table, rig_map: RigMap, columns: dict[str, np.ndarray], parts: Mapping[str, Column],
    notes: list[str],
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the time (s) and the columns at these times."""
    source = table.source
    own: dict[str, np.ndarray] = {}
    for name, part in parts.items():
        if part.time is not None:
            own[name] = seconds(table, part.time.column, part.time.unit, f"{name}.time")
        elif (label := table.name_of(part.column, name)) in table.times:
            own[name] = table.times[label]
    lengths = {name: len(values) for name, values in columns.items()}
    time = np.empty(0)
    if len(own) < len(columns):
        if rig_map.time.column is None:
            assert rig_map.time.rate is not None
            time = np.arange(next(lengths[n] for n in columns if n not in own)) / rig_map.time.rate
        else:
            time = seconds(table, rig_map.time.column, rig_map.time.unit, "time")
    wrong = {name: n for name, n in lengths.items() if n != len(own.get(name, time))}
    if wrong:
        raise InvalidRecordError(
            f"{source}: columns of different length: " + ", ".join(
                f"{k} {n}" for k, n in {**lengths, "time": len(time)}.items())
            + ": give each its own 'time: {column, unit}' if they were sampled apart")
    if not own and not rig_map.mixed_rates:
        return time, columns
    if rig_map.run is not None:
        raise UsageError(f"{source}: 'run' with columns of several clocks: import the runs one by "
                         "one")
    time, columns, said = one_clock(
        columns, {name: own.get(name, time) for name in columns}, source)
    notes += said
    return time, columns


def _joined(
    table: Table, rig_map: RigMap, columns: dict[str, np.ndarray], parts: Mapping[str, Column],
    channels: tuple[Channel, ...], notes: list[str],
) -> tuple[np.ndarray, tuple[Channel, ...]]:
    """Return all columns with time in front, within the bounds of time, and their channels."""
    source = table.source
    time, columns = _clocked(table, rig_map, columns, parts, notes)
    if rig_map.time.zero:
        unit = "s" if rig_map.time.unit in (ISO, CLOCK) else rig_map.time.unit
        time = time - rig_map.time.zero * unit_factor(unit, "time", f"{source}: time")
    chosen = tuple(c for c in channels if c.name == "time" or c.name in columns)
    ordered = [time if c.name == "time" else columns[c.name] for c in chosen]
    samples = np.column_stack(ordered)
    labels, words = (restarts(time), {}) if rig_map.run is None else run_labels(
        table, rig_map.run.column)
    if len(labels) != len(time):
        raise InvalidRecordError(f"{source}: columns of different length: time {len(time)}, run "
                                 f"{len(labels)}")
    if rig_map.run is not None:
        inside = chosen_runs(labels, rig_map.run.only, source, words)
        samples, time, labels = samples[inside], time[inside], labels[inside]
    if not len(time):
        raise InvalidRecordError(f"{source}: no samples of this axis: look at its columns")
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
    samples, labels, told = single_stamps(samples, labels, rig_map.duplicates, source)
    notes += told
    samples, labels = _without_missing(samples, labels, source, notes)
    if rig_map.axis == "actuator":
        _check_one_test(samples[:, 0], labels, source)
    samples[:, 0], told = one_after_another(samples[:, 0], labels, source)
    notes += told
    _describe_time(samples[:, 0], notes)
    return samples, chosen


def _check_one_test(time: np.ndarray, labels: np.ndarray, source: str) -> None:
    """Refuse a file of several tests, and times that do not count from the command of one."""
    if (np.diff(labels) != 0.0).any():
        raise UsageError(f"{source}: {1 + np.count_nonzero(np.diff(labels))} runs, a record holds "
                         "one test: choose one with 'run: {column, only}', or split the file")
    if len(time) and not 0.0 <= time[0] <= MAX_DURATION:
        raise UsageError(f"{source}: its times begin at {time[0]:.12g} s, those of a test count "
                         "from its command: set time.zero to the time of the command, and "
                         "'start: 0' where it was recorded before it")


def _without_missing(
    samples: np.ndarray, labels: np.ndarray, source: str, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Leave out rows with a value that is missing, if they are few."""
    bad = ~np.isfinite(samples).all(axis=1)
    if bad.mean() > MAX_LOST:
        raise InvalidRecordError(
            f"{source}: {bad.sum()} of {len(bad)} rows lack a value, at most "
            f"{100 * MAX_LOST:g} %: set 'mixed_rates: true' if columns were sampled at different "
            "rates, choose other columns, or a part with 'start' and 'end'"
        )
    if bad.any():
        notes.append(f"{counted(bad.sum(), 'row')} without a value left out")
    return samples[~bad], labels[~bad]


def _describe_time(time: np.ndarray, notes: list[str]) -> None:
    """Say what is irregular about the sampling; nothing is changed."""
    steps = np.diff(time)
    if len(steps) == 0 or steps.min() <= 0.0:
        return  # refused by the record itself, with the row
    median = float(np.median(steps))
    gaps = steps[steps > GAP * median]
    if len(gaps):
        notes.append(f"{counted(len(gaps), 'gap')} in time of more than {GAP:g} intervals, the "
                     f"longest {gaps.max():.3g} s")
    spread = float(np.quantile(np.abs(steps - median), 0.99) / median)
    if spread > 0.01:
        notes.append(f"irregular sampling: 1 % of the intervals differ from the median "
                     f"{median:.4g} s by more than {100 * spread:.0f} %")


def _actuator(rig_map: RigMap, path: Path, notes: list[str]) -> Record:
    """Return the record of our actuator's own test."""
    table = _table(rig_map, path, rig_map.channels.values())
    notes += table.notes
    columns = {
        channel.name: _converted(
            table, rig_map.channels[channel.name], channel.name, _QUANTITY_OF[channel.unit])
        for channel in CHANNELS[1:] if channel.name in rig_map.channels
    }
    recorded, chosen = _joined(table, rig_map, columns, rig_map.channels, CHANNELS, notes)
    samples = np.full((len(recorded), N_CHANNELS), np.nan)
    samples[:, [CHANNELS.index(channel) for channel in chosen]] = recorded
    # An angle is known up to turns: a shaft's, times the pole pairs, goes through several.
    samples[:, ROTOR_ANGLE] %= 2.0 * np.pi
    check_samples(samples, str(path))
    bus, warm = rig_map.bus_voltage, rig_map.winding_temperature
    return Record(
        samples=samples, profile=load_profile(rig_map.profile),
        provenance=Provenance(software_version=VERSION, source=str(path),
                              serial_number=rig_map.serial_number),
        dc_bus=np.array([] if bus is None else [0.0, bus, 0.0]).reshape(-1, 3),
        winding_temperature=np.array([] if warm is None else [0.0, warm]).reshape(-1, 2),
    )
