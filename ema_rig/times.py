"""Clocks of files: dates, equal stamps, columns sampled at different times, several runs.

Runs are told apart by a column or by a time that starts again.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from ema_record.errors import InvalidRecordError, UsageError, counted
from ema_rig.table import Table, TextColumn
from ema_rig.units import unit_factor

ISO, CLOCK = "iso", "h:m:s"
"""Units of a time that is written as text."""
HOLE = 10.0
"""A column is not interpolated over more than so many of its own intervals."""
_NS = 1_000_000_000
_DATE = re.compile(
    r"^(\d{4}-\d\d-\d\d)[T ]+(\d\d?:\d\d:\d\d)(?:[.,](\d{1,9})\d*)?\s*"
    r"(?:(Z|UTC)|([+-])(\d\d):?(\d\d))?$")
_HMS = re.compile(r"^(?:(\d+):)?(\d\d?):(\d\d?(?:[.,]\d*)?)$")


def seconds(table: Table, name: str | int, unit: str, where: str) -> np.ndarray:
    """Return a column of time, shape (n,) (s); dates count from the first of them.

    Raises
    ------
    UsageError, InvalidRecordError
        Another unit; a cell that is no time, which is named.
    """
    text = table.text(name, where)
    if (label := table.name_of(name, where)) in table.stamps:
        if unit not in ("s", ISO, CLOCK):
            raise UsageError(f"{table.source}: {where}: unit {unit!r}, but {label!r} holds times, "
                             "whose unit the file gives by their type: set unit: s")
        return table.column(name, where)
    if unit not in (ISO, CLOCK):
        factor = unit_factor(unit, "time", f"{table.source}: {where}")
        if text is not None:
            _refuse_words(table, text, table.name_of(name, where), where, unit)
        return table.column(name, where) * factor
    if text is None:
        raise UsageError(f"{table.source}: {where}: unit {unit!r}, but the column holds numbers: "
                         "give the unit of them, as s or ms")
    label = table.name_of(name, where)
    parse = _date if unit == ISO else _clock
    values = np.empty(sum(len(p.cells) or len(p.values if p.values is not None else ())
                          for p in text.parts), dtype=np.int64)
    for row, (line, cell) in enumerate(text.words()):
        found = parse(cell.strip())
        if found is None:
            form = "2024-01-31T12:00:00.5" if unit == ISO else "12:00:00.5"
            raise InvalidRecordError(
                f"{table.source}: line {line}, column {label!r}: {cell[:40]!r} is no time of the "
                f"form {form}: correct that cell")
        values[row] = found
    if unit == CLOCK:  # past midnight
        values += 86_400 * _NS * np.concatenate(
            [[0], np.cumsum(np.diff(values) < -43_200 * _NS)])
        return values / _NS
    return (values - values[0]) / _NS


def time_form(cell: str) -> str | None:
    """Return `ISO` or `CLOCK` where a cell has that form."""
    cell = cell.strip()
    return ISO if _date(cell) is not None else CLOCK if _clock(cell) is not None else None


def _refuse_words(table: Table, text: TextColumn, label: str, where: str, unit: str) -> None:
    """Refuse a time in words that has the unit of numbers, with the unit that it should have."""
    _, first = next(text.words())
    form = time_form(first)
    if form is not None:
        raise UsageError(f"{table.source}: {where}: column {label!r} holds {first[:30]!r}, no "
                         f"numbers in {unit}: set unit: {form}")


def _date(cell: str) -> int | None:
    """Return a date of ISO 8601 as ns since the epoch."""
    found = _DATE.match(cell)
    if found is None:
        return None
    day, clock, part, _, sign, hours, minutes = found.groups()
    try:
        whole = int(np.datetime64(f"{day}T{clock.zfill(8)}", "s").astype(np.int64))
    except ValueError:
        return None
    if sign:
        whole -= int(f"{sign}1") * (3600 * int(hours) + 60 * int(minutes))
    return whole * _NS + int((part or "0").ljust(9, "0"))


def _clock(cell: str) -> int | None:
    """Return h:m:s or m:s as ns."""
    found = _HMS.match(cell)
    if found is None:
        return None
    hours, minutes, part = found.groups()
    return round((3600 * int(hours or 0) + 60 * int(minutes)) * _NS
                 + float(part.replace(",", ".")) * _NS)


def unwrapped(values: np.ndarray, period: float) -> np.ndarray:
    """Return a counter that starts again after `period` as one that goes on, shape (n,)."""
    found = values.copy()
    good = np.isfinite(values)
    found[good] = np.unwrap(values[good], period=period)
    return found


def single_stamps(
    samples: np.ndarray, labels: np.ndarray, how: str | None, source: str
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return rows without equal time stamps, their runs, and what was done.

    Parameters
    ----------
    samples : ndarray, shape (n, m). Time first.
    labels : ndarray, shape (n,). Of the run of each row.
    how : ``drop`` keeps the first row of equal time, ``mean`` the mean of their values, those that
        are missing left out; None refuses them.
    source : for errors.

    Raises
    ------
    InvalidRecordError
        Equal stamps, and nothing said about them.
    """
    again = np.concatenate([[False], (np.diff(samples[:, 0]) == 0.0) & (np.diff(labels) == 0.0)])
    if not again.any():
        return samples, labels, []
    if how is None:
        row = int(np.argmax(again))
        raise InvalidRecordError(
            f"{source}: {counted(again.sum(), 'time stamp')} equal to the one before, first at "
            f"sample {row} ({samples[row, 0]:.9g} s): set 'duplicates: drop' or 'duplicates: "
            "mean' in the map")
    first = np.nonzero(~again)[0]
    kept = samples[first]
    if how == "mean":
        good = np.isfinite(samples)
        total = np.add.reduceat(np.where(good, samples, 0.0), first, axis=0)
        count = np.add.reduceat(good.astype(np.float64), first, axis=0)
        with np.errstate(invalid="ignore"):
            kept = np.where(count > 0, total / count, np.nan)
        kept[:, 0] = samples[first, 0]
    done = "averaged" if how == "mean" else "left out"
    return kept, labels[first], [
        f"{counted(again.sum(), 'row')} of a time stamp that was there {done}"]


def one_clock(
    columns: dict[str, np.ndarray], times: dict[str, np.ndarray], source: str
) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """Return columns of several clocks at the times of the slowest of them.

    Nothing is invented: the slowest column keeps its samples, the others are interpolated linearly
    between samples that are nearer together.

    Parameters
    ----------
    columns, times : dict of ndarray, shape (n,) of each column. Values and when they were taken
        (s).
    source : for errors.

    Returns
    -------
    time : ndarray
        Times of the slowest column, as far as all columns go (s).
    columns : dict of ndarray
        NaN in holes of more than `HOLE` intervals.
    notes : list of str
        What was done.

    Raises
    ------
    InvalidRecordError
        Fewer than two samples of a column; they do not overlap; a time that does not increase.
    """
    clean: dict[str, tuple[np.ndarray, np.ndarray, float]] = {}
    for name, values in columns.items():
        good = np.isfinite(values) & np.isfinite(times[name])
        at, kept = times[name][good], values[good]
        steps = np.diff(at)
        if len(steps) and -steps.min() > HOLE * np.median(np.abs(steps)):
            raise InvalidRecordError(f"{source}: {name}: its time runs back to "
                                     f"{at[int(np.argmin(steps)) + 1]:.6g} s: a file of several "
                                     "runs: import them one by one ('start' and 'end')")
        order = np.argsort(at, kind="stable")
        at, kept = at[order], kept[order]
        new = np.concatenate([[True], np.diff(at) > 0.0])[:len(at)]
        at, kept = at[new], kept[new]
        if len(at) < 2:
            raise InvalidRecordError(f"{source}: {name}: {len(at)} values with a time of their "
                                     "own: name another column")
        clean[name] = at, kept, float(np.median(np.diff(at)))
    slowest = max(clean, key=lambda name: clean[name][2])
    start, end = (max(at[0] for at, _, _ in clean.values()),
                  min(at[-1] for at, _, _ in clean.values()))
    time = clean[slowest][0]
    time = time[(time >= start) & (time <= end)]
    if len(time) < 2:
        raise InvalidRecordError(f"{source}: the columns were not recorded at the same time "
                                 f"({slowest} from {clean[slowest][0][0]:.6g} s, others until "
                                 f"{end:.6g} s): name columns of one recording")
    found = {}
    for name, (at, values, step) in clean.items():
        found[name] = np.interp(time, at, values)
        after = np.clip(np.searchsorted(at, time), 1, len(at) - 1)
        hole = (at[after] - at[after - 1] > HOLE * step) & (at[after] != time) & (
            at[after - 1] != time)
        found[name][hole] = np.nan
    rates = ", ".join(f"{name} {1.0 / step:.4g}" for name, (_, _, step) in clean.items())
    return time, found, [f"columns of different rates ({rates} 1/s) taken at the times of "
                         f"{slowest}"]


BETWEEN = 20.0
"""Median intervals between two runs that are put one after the other, and at least a second."""
AGAIN = 0.05
"""A time that falls to within this share of the run's length from its start starts again."""
MAX_RUNS = 1000


def restarts(time: np.ndarray) -> np.ndarray:
    """Return the number of the run of each sample from 0, by a time that starts again, (n,).

    A time that only steps back is no new run; the record refuses it.
    """
    number, first = np.zeros(len(time)), 0
    for row in np.nonzero(np.diff(time) < 0.0)[0] + 1:
        length = time[row - 1] - time[first]
        if abs(time[row] - time[first]) > AGAIN * length:
            return np.zeros(len(time))
        number[row], first = 1.0, int(row)
    return np.cumsum(number)


def run_labels(table: Table, name: str | int) -> tuple[np.ndarray, dict[float, str]]:
    """Return the number of the run of each row, shape (n,), and the words that they stand for.

    Words are numbered as they first occur; an empty one belongs to no run (NaN).
    """
    text = table.text(name, "run")
    if text is None:
        return table.column(name, "run"), {}
    numbers: dict[str, float] = {}
    labels = np.array([numbers.setdefault(word, float(len(numbers))) if word else np.nan
                       for _, word in text.words()])
    return labels, {number: word for word, number in numbers.items()}


def chosen_runs(
    labels: np.ndarray, only: Sequence[float | str], source: str, words: Mapping[float, str]
) -> np.ndarray:
    """Return which samples belong to the runs that are wanted, shape (n,) of bool.

    Raises
    ------
    UsageError
        A run that is wanted is not in the file.
    """
    known = {words.get(value, float(value)): float(value)
             for value in np.unique(labels[np.isfinite(labels)])}
    for label in only:
        if label not in known:
            shown, *listed = (f"{key:g}" if isinstance(key, float) else key
                              for key in (label, *list(known)[:12]))
            raise UsageError(f"{source}: run.only: no run {shown}; the file has "
                             f"{', '.join(listed)}")
    wanted: np.ndarray = np.isin(labels, [known[label] for label in only]) if only else (
        np.isfinite(labels))
    return wanted


def one_after_another(
    time: np.ndarray, labels: np.ndarray, source: str
) -> tuple[np.ndarray, list[str]]:
    """Return a time in which the runs follow one another with a gap, and what was done.

    Parameters
    ----------
    time : ndarray, shape (n,). As the file counts it, each run for itself (s).
    labels : ndarray, shape (n,). Of the run of each sample; a change is a new run.
    source : for errors.

    Returns
    -------
    time : ndarray, shape (n,)
        The first run keeps its times (s).
    notes : list of str
        Empty for a single run.

    Raises
    ------
    UsageError
        More than `MAX_RUNS` runs.
    """
    changes = np.nonzero(np.diff(labels) != 0.0)[0] + 1
    if not len(changes):
        return time, []
    if len(changes) >= MAX_RUNS:
        raise UsageError(f"{source}: {len(changes) + 1} runs, at most {MAX_RUNS}: name the column "
                         "that numbers the runs, or choose some with run.only")
    steps = np.diff(time)
    gap = max(1.0, BETWEEN * float(np.median(steps)))
    whole = time.copy()
    for row in changes:
        whole[row:] += whole[row - 1] + gap - whole[row]
    return whole, [f"{len(changes) + 1} runs, put one after the other with {gap:.3g} s between"]
