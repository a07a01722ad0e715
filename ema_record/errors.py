"""Errors that users see, each one line: what, the value, the bound, the remedy.

Tree::

    EmaError                    exit status 2
    |-- UsageError              wrong name, value or file given by the user
    |-- OutputError             a result cannot be written (exists, no permission, disk full)
    |-- RecordError             a record cannot be used
    |   |-- InvalidRecordError      it is damaged or is not a record
    |   |   `-- RigRecordError          it is of a rig, not of the actuator's own test
    |   `-- IncompleteRecordError   it is a part of a record         (exit status 3)
    |-- ModelError              a model file is damaged, foreign or of another version
    |-- SimulationError         the simulation left its domain (not finite, too many events)
    `-- TestRefusedError        the built-in test may not run, or was aborted  (exit status 3)
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from types import ModuleType

_Model = TypeVar("_Model")


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


class RigRecordError(InvalidRecordError):
    """The record is a rig's, not one of the actuator's own test."""


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
    kind : what the name stands for, e.g. ``"effect"``.
    name : the name as given.
    known : all valid names.
    remedy : where the valid names are listed, e.g. ``"ema effects lists them"``.
    """
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return UsageError(f"unknown {kind} {name!r}: {hint}{remedy}")


def bounded(name: str, value: object, lower: float, upper: float, unit: str = "") -> float:
    """Return `value` as a number within [`lower`, `upper`]; UsageError where it is not."""
    given = f"give {lower:g} to {upper:g} {unit}".removesuffix(" 1").rstrip()
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise UsageError(f"{name}: {str(value)[:60]!r} is not a number: {given}") from None
    if not lower <= number <= upper:
        raise UsageError(f"{name}: {number:g} is out of bounds: {given}")
    return number


def library(name: str, purpose: str, instead: str, extra: str = "") -> ModuleType:
    """Return a library, of our `extra`, needed by few; UsageError where it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        wheel = f"'ema_phm[{extra}]'" if extra else name
        raise UsageError(f"{purpose} needs the package {name}, which is not installed: "
                         f"pip install {wheel}, or {instead}") from None


def counted(number: int, thing: str) -> str:
    """Return a number of things, e.g. ``1 row`` or ``2 rows``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def validated(
    validate: Callable[[Any], _Model], data: object, where: str, whole: str, remedy: str, *,
    branch: str = "", kind: type[EmaError] = UsageError,
) -> _Model:
    """Return what pydantic makes of data; its first problem is one line.

    Parameters
    ----------
    validate : of a model or a type adapter.
    where : the file or topic that the data come from.
    whole : name of the whole, where no field of it is to blame.
    remedy : what to do, or where the form is shown.
    branch : of a union pydantic reports every branch; a problem in the one of this name says the
        most.
    kind : of the error: where, field, what, value, remedy.
    """
    from pydantic import ValidationError

    try:
        return validate(data)
    except ValidationError as error:
        problems = error.errors()

    def is_branch(part: object) -> bool:
        return str(part) == branch or str(part).endswith(f", {branch}]")  # with a validator

    first = next((p for p in problems if any(map(is_branch, p["loc"]))), problems[0])
    place = ".".join(str(part) for part in first["loc"] if not is_branch(part)) or whole
    bounds = first.get("ctx", {})
    what = {
        "extra_forbidden": "no such key", "missing": "is missing",
        "too_short": f"needs at least {counted(bounds.get('min_length', 0), 'item')}",
        "too_long": f"may have {counted(bounds.get('max_length', 0), 'item')} at most",
    }.get(first["type"], first["msg"].removeprefix("Value error, "))
    what = what.replace("Input should", "must", 1)
    value = "" if isinstance(first["input"], dict) else f" (value {str(first['input'])[:60]})"
    raise kind(f"{where}: {place[:120]}: {what}{value}: {remedy}")
