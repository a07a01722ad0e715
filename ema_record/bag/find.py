"""Which paths are bags, which folders hold them; damaged bags count, no content is read."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from ema_record.bag.container import METADATA_FILE, STORAGE
from ema_record.bag.mcap_stream import MAGIC
from ema_record.errors import InvalidRecordError, UsageError

MAX_IN_FOLDER = 10_000
"""Bags of one folder, each a flight."""
MAX_BAGS = 1_000_000
MAX_DEPTH = 20
"""Folders within folders."""


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return a key that sorts names with their numbers as numbers: 2 before 10."""
    return tuple(
        (0, int(part), "") if part.isdecimal() else (1, 0, part)
        for part in re.split(r"([0-9]+)", name) if part
    )


def named(path: Path) -> Path:
    """Return a path under its name where it is given as ``.`` or ``..``."""
    return path if path.name not in ("", "..") else path.resolve()


def is_sequence(path: Path) -> bool:
    """Return whether `path` is a directory of bags, and not a bag itself.

    A directory with ``metadata.yaml`` is a bag; so is one with a single file of messages, or
    with files named after it (``NAME/NAME_0.mcap``), whose recording was cut. One that holds
    bags, be they directories or several single files, is a sequence.
    """
    try:
        if not path.is_dir() or (path / METADATA_FILE).is_file():
            return False
        entries = list(path.iterdir())
        files = [p for p in entries if p.name.endswith(STORAGE)]
        folders = [p for p in entries if p.is_dir() and _is_bag(p)]
    except OSError:
        return False  # the reader says what is wrong
    return bool(folders) or (len(files) > 1 and not _of_one(path, files))


def _of_one(folder: Path, files: Iterable[Path]) -> bool:
    """Return whether files are the first parts of one bag, named after its folder."""
    names, own = {p.name for p in files}, folder.resolve().name
    return all(any(f"{own}_{k}{end}" in names for end in STORAGE) for k in range(len(names)))


def _is_bag(path: Path) -> bool:
    """Return whether an entry of a directory is meant as a bag; damaged ones are."""
    if path.name.startswith("."):
        return False
    if path.is_dir():
        try:
            entries = [p.name for p in path.iterdir()]
        except OSError:
            return True  # shown as a flight that cannot be read
        # An empty directory is what is left of a recorder that died at once.
        return not entries or METADATA_FILE in entries or any(
            name.endswith(STORAGE) for name in entries
        )
    return path.name.endswith(STORAGE)


def what_else(path: Path) -> str | None:
    """Return what a path is that is no bag, or None for a bag, also a damaged one."""
    try:
        if path.is_dir():
            if not any(path.iterdir()):
                return "an empty directory"
            return None if _is_bag(path) else "a directory that is no bag"
        if not path.is_file():
            return "neither file nor directory" if path.exists() else "no such file or directory"
        if path.name.endswith(STORAGE):
            return None
        with path.open("rb") as file:
            begin = file.read(1024)
    except OSError as error:
        return f"cannot be read ({error.strerror or error})"
    if begin.startswith(MAGIC):
        return None
    kind = "a file of another kind" if b"\0" in begin else "a text file" if begin else "empty"
    return f"{kind}, no bag"


def bags_of(directory: Path) -> tuple[list[Path], list[Path]]:
    """Return the bags in a directory by name, and its other entries; hidden ones are left out.

    Raises
    ------
    UsageError
        More than `MAX_IN_FOLDER`.
    """
    entries = sorted(
        (p for p in directory.iterdir() if not p.name.startswith(".")),
        key=lambda p: natural(p.name),
    )
    bags = [p for p in entries if _is_bag(p)]
    if len(bags) > MAX_IN_FOLDER:
        raise UsageError(
            f"{directory}: {len(bags)} bags, at most {MAX_IN_FOLDER} at once: give some of them"
        )
    return bags, [p for p in entries if p not in set(bags)]


def bags_below(paths: Iterable[Path]) -> list[Path]:
    """Return the bags among `paths` and in folders below them, in natural order of the names.

    Hidden entries are left out; a folder is looked at once, however many links lead to it. A path
    without a bag counts as one that cannot be read.

    Raises
    ------
    InvalidRecordError
        A path that is not there, no bag at all, or folders more than `MAX_DEPTH` deep.
    UsageError
        More than `MAX_BAGS`.
    """
    found: list[Path] = []
    seen: set[Path] = set()
    known: set[Path] = set()
    empty = 0
    for path in map(named, paths):
        other = None if path.is_dir() else what_else(path)
        if other is not None:
            raise InvalidRecordError(f"{path}: {other}: give a folder with bags in it, or below")
        if (place := path.resolve()) in seen or place in known:  # below what was given before
            continue
        before = len(found)
        for bag in _below(path, 0, seen) if path.is_dir() else (path,):
            known.add(bag.resolve())
            found.append(bag)
            if len(found) > MAX_BAGS:
                raise UsageError(f"{path}: more than {MAX_BAGS} bags: give some of the folders")
        if len(found) == before:
            found.append(path)
            empty += 1
    if len(found) == empty:
        raise InvalidRecordError("no bag: give a folder with bags in it, or below")
    return found


def _below(folder: Path, depth: int, seen: set[Path]) -> Iterator[Path]:
    """Yield the bags in a folder that may be one itself, and was not `seen`."""
    try:
        place = folder.resolve()
        if place in seen:
            return
        seen.add(place)
        entries = [p for p in folder.iterdir() if not p.name.startswith(".")]
    except OSError:
        yield folder  # the reader says what is wrong
        return
    if depth > MAX_DEPTH:
        raise InvalidRecordError(f"{folder}: more than {MAX_DEPTH} folders deep: give a folder "
                                 "nearer to the bags")
    files = {p for p in entries if p.name.endswith(STORAGE)}
    folders = [p for p in entries if p not in files and p.is_dir()]
    whole = any(p.name == METADATA_FILE for p in entries)
    if whole or (files and not folders and (len(files) == 1 or _of_one(folder, files))):
        yield folder
        files, folders = set(), [p for p in folders if what_else(p) is None]
    if not entries and depth:
        yield folder  # what is left of a recorder that died at once
    for path in sorted([*files, *folders], key=lambda p: natural(p.name)):
        if path in files:
            yield path
        else:
            yield from _below(path, depth + 1, seen)
