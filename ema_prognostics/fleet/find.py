"""The bags below folders, however deep."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from ema_prognostics.trend.flights import STORAGE, natural, what_else
from ema_record.bag.container import METADATA_FILE
from ema_record.errors import InvalidRecordError, UsageError

MAX_BAGS = 1_000_000
MAX_DEPTH = 20
"""Folders within folders."""


def bags_below(paths: Iterable[Path]) -> list[Path]:
    """Return the bags among `paths` and in folders below them, in natural order of the names.

    Hidden entries and links to folders are left out.

    Raises
    ------
    InvalidRecordError
        A path that is not there, or no bag at all.
    UsageError
        More than `MAX_BAGS`.
    """
    found: list[Path] = []
    for path in paths:
        other = None if path.is_dir() else what_else(path)
        if other is not None:
            raise InvalidRecordError(f"{path}: {other}: give a folder with bags in it, or below")
        for bag in _below(path, 0) if path.is_dir() else (path,):
            found.append(bag)
            if len(found) > MAX_BAGS:
                raise UsageError(f"{path}: more than {MAX_BAGS} bags: give some of the folders")
    if not found:
        raise InvalidRecordError("no bag: give a folder with bags in it, or below")
    return found


def _below(folder: Path, depth: int) -> Iterator[Path]:
    """Yield the bags in a folder that may be one itself."""
    try:
        entries = [p for p in folder.iterdir() if not p.name.startswith(".")]
    except OSError:
        yield folder  # the reader says what is wrong
        return
    names = {p.name for p in entries}
    files = [p for p in entries if p.name.endswith(STORAGE)]
    folders = [p for p in entries if p not in files and p.is_dir() and not p.is_symlink()]
    cut = any(p.name.startswith(f"{folder.resolve().name}_") for p in files)
    if METADATA_FILE in names or cut or (len(files) == 1 and not folders):
        yield folder
        return
    if not entries and depth:
        yield folder  # what is left of a recorder that died at once
    for path in sorted([*files, *folders], key=lambda p: natural(p.name)):
        if path in files:
            yield path
        elif depth < MAX_DEPTH:
            yield from _below(path, depth + 1)
