"""Several runs in one file: told apart by a column or by a time that starts again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ema_record.errors import UsageError
from ema_rig.table import Table

BETWEEN = 20.0
"""Median intervals between two runs that are put one after the other, and at least a second."""
AGAIN = 0.05
"""A time that falls to within this share of the run's length from its start starts again."""
MAX_RUNS = 1000


def restarts(time: np.ndarray) -> np.ndarray:
    """Return the number of the run of each sample from 0, by a time that starts again, (n,).

    A time that only steps back is no new run; the record refuses it.
    """
    number = np.zeros(len(time), dtype=np.float64)
    first = 0
    for row in np.nonzero(np.diff(time) < 0.0)[0] + 1:
        length = time[row - 1] - time[first]
        if abs(time[row] - time[first]) > AGAIN * length:
            return np.zeros(len(time))
        number[row:] += 1.0
        first = int(row)
    return number


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
    time : ndarray, shape (n,)
        As the file counts it, each run for itself (s).
    labels : ndarray, shape (n,)
        Of the run of each sample; a change is a new run.
    source : str
        For errors.

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
