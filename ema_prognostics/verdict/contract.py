"""The JSON object of a verdict, a contract for machines: `SCHEMA` is its version.

What `Verdict.to_dict` says, of which unit, test and record, and what judged it: software,
networks, kit. Keys may be added under the same version; none goes or changes its meaning. The
JSON Schema is `verdict.schema.json` beside this file.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

from ema_prognostics.verdict.verdict import Judged
from ema_record.bag.content_hash import content_hash
from ema_record.kit import ACTUATOR, CASCADE, PROFILES, is_default_kit, kit_folder
from ema_record.record import iso_time, known_serial
from ema_record.version import VERSION

SCHEMA = "ema_phm.verdict/1"


def kit_files() -> list[Path]:
    """Return the files of the present kit that a verdict depends on."""
    folder = kit_folder()
    return [path for path in (
        folder / ACTUATOR, folder / CASCADE, *sorted((folder / PROFILES).glob("*.yaml")))
        if path.is_file()]


def kit_sha256() -> str:
    """Return the SHA-256 over names and bytes of `kit_files`, each with a zero byte behind it."""
    digest = hashlib.sha256()
    for path in kit_files():
        digest.update(os.fsencode(path.name) + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def trace_of(model_sha256: str) -> dict[str, Any]:
    """Return what judges: software, networks, kit."""
    return {
        "software_version": VERSION, "model_sha256": model_sha256,
        "kit": {"name": "default" if is_default_kit() else kit_folder().name,
                "sha256": kit_sha256()},
    }


def verdict_object(
    judged: Judged, trace: dict[str, Any], *, record_sha256: str | None = None
) -> dict[str, Any]:
    """Return the object.

    Parameters
    ----------
    judged : verdict, with the path of its bag, and test.
    trace : of `trace_of`.
    record_sha256 : of the bag; None: computed here where the bag could be read; empty: none.
    """
    verdict, serial_number, start_time, profile = judged
    return {
        "schema": SCHEMA, **verdict.to_dict(),
        "serial_number": known_serial(serial_number) or None,
        "time": iso_time(start_time), "profile": profile or None,
        "record_sha256": (hash_of(verdict.bag) if profile else None)
        if record_sha256 is None else record_sha256 or None, **trace,
    }


def hash_of(bag: str) -> str | None:
    """Return the hash of a bag's content, None where it cannot be read."""
    try:
        return content_hash(bag)
    except OSError:
        return None
