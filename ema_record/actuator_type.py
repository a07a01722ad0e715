"""Which type of actuator a record is of: the hash of its description, named in each record."""

from __future__ import annotations

import hashlib
import json

from ema_record.actuator import FORMERLY, load_actuator, sections_of
from ema_record.errors import UsageError
from ema_record.kit import ACTUATOR, kit_name, kit_path


def actuator_hash() -> str:
    """Return what names the present kit's actuator in records: of its parameters, 16 digits.

    A parameter that has a default is of no account at it, so that one more renames no actuator.
    """
    parts = {name: {key: value for key, value in part._asdict().items()
                    if part._field_defaults.get(key) != value}
             for name, part in load_actuator()._asdict().items()}
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def actuator_hashes() -> tuple[str, ...]:
    """Return all that may name the present kit's actuator in a record, `actuator_hash` first.

    The others are those of earlier descriptions of the same type: who corrects a description
    that records were taken with keeps its hash in the list ``formerly`` of `actuator.yaml`.

    Raises
    ------
    UsageError
        ``formerly`` is no list of hashes.
    """
    path = kit_path(ACTUATOR)
    former = sections_of(path).get(FORMERLY) or []
    if not isinstance(former, list) or not all(isinstance(name, str) for name in former):
        raise UsageError(f"{path}: {FORMERLY}: expected a list of hashes in quotes")
    return actuator_hash(), *former


OWN_KIT = "give the kit that it was recorded with (--kit DIR)"
"""What to do about a record of another actuator."""


def is_of_another_actuator(named: str) -> bool:
    """Return whether a record that names its actuator so is not of the present kit's."""
    return bool(named) and named != actuator_hash() and named not in actuator_hashes()


def another_actuator(named: str) -> str:
    """Return in words that a record names another actuator than the present kit's."""
    return (f"the record is of the actuator {named[:16]!r}, {kit_name()} describes "
            f"{actuator_hash()!r}")
