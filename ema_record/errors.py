"""Errors that users see, each one line: what, the value, the bound, the remedy.

Tree::

    EmaError                    exit status 2
    |-- UsageError              wrong name, value or file given by the user
    |-- OutputError             a result cannot be written (exists, no permission, disk full)
    |-- RecordError             a record cannot be used
    |   |-- InvalidRecordError      it is damaged or is not a record
    |   `-- IncompleteRecordError   it is a part of a record         (exit status 3)
    |-- ModelError              a model file is damaged, foreign or of another version
    |-- SimulationError         the simulation left its domain (not finite, too many events)
    `-- TestRefusedError        the built-in test may not run, or was aborted  (exit status 3)
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class EmaError(Exception):
    """Base of every error that a user can mend; its text is one line."""

    exit_status = 2


class UsageError(EmaError):
    """A name, value or file given by the user is wrong."""


class OutputError(EmaError):
    """A result cannot be written; nothing that existed was touched."""


class RecordError(EmaError):
    """A record cannot be used."""


class InvalidRecordError(RecordError):
    """The record is damaged, or is no record at all."""


class IncompleteRecordError(RecordError):
    """The record is a part of a whole: cut, aborted, or too short."""

    exit_status = 3


class ModelError(EmaError):
    """A model file is damaged, foreign or of another version."""


class SimulationError(EmaError):
    """The simulation left the domain in which it is valid."""


class TestRefusedError(EmaError):
    """The built-in test may not run now, or was aborted."""

    __test__ = False
    exit_status = 3


def unknown_name(kind: str, name: str, known: Iterable[str], remedy: str) -> UsageError:
    """Return the error for a name that is not known, with the nearest one that is.

    Parameters
    ----------
    kind : str
        What the name stands for, e.g. ``"effect"``.
    name : str
        The name as given.
    known : iterable of str
        All valid names.
    remedy : str
        Where the valid names are listed, e.g. ``"ema effects lists them"``.

    """
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return UsageError(f"unknown {kind} {name!r}: {hint}{remedy}")
