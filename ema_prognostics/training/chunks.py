"""Parts of a campaign on disk, so that one that was stopped goes on where it was."""

from __future__ import annotations

import hashlib
import json
import os
from functools import cache
from pathlib import Path

from ema_record.resources import share_path
from ema_record.sources import source_hash

Features = dict[str, float]
Tests = list[tuple[int, Features]]
MAX_BYTES = 16 << 20
MODULE = "ema_prognostics.training.campaign"
"""Decides, with all that it imports, what a campaign gives."""
DATA = ("config/actuator.yaml", "config/profiles/step.yaml", "config/profiles/extended.yaml")
"""Files that decide it too."""


@cache
def sources_hash() -> str:
    """Return a hash of all that decides the features: simulator, extraction, data."""
    digest = hashlib.sha256(source_hash(MODULE).encode())
    for name in DATA:
        digest.update(share_path(name).read_bytes())
    return digest.hexdigest()


def chunk_file(folder: Path | None, key: tuple[object, ...]) -> Path | None:
    """Return the file of a part; another `key` or other sources give another file."""
    if folder is None:
        return None
    text = json.dumps([sources_hash(), *key])
    return folder / f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.json"


def load_chunk(file: Path | None) -> tuple[list[Features], list[Tests]] | None:
    """Return (baselines, tests) as kept in `file`, None where there is none or it is damaged."""
    if file is None or not file.is_file() or file.stat().st_size > MAX_BYTES:
        return None
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        return data["baselines"], [[(int(k), v) for k, v in tests] for tests in data["tests"]]
    except (ValueError, KeyError, TypeError):
        return None


def save_chunk(file: Path | None, baselines: list[Features], tests: list[Tests]) -> None:
    """Keep a part; a half-written file never has its name."""
    if file is None:
        return
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_suffix(f".{os.getpid()}")
    temporary.write_text(json.dumps({"baselines": baselines, "tests": tests}), encoding="utf-8")
    temporary.replace(file)
