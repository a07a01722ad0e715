"""What a bag holds, as one SHA-256, and whether its files have changed since it was taken."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ema_record.bag.container import find_files
from ema_record.errors import RecordError

BLOCK = 1 << 20


def bag_files(bag: Path) -> list[Path]:
    """Return the files of a bag, in order of their names; a single file is itself.

    Hidden ones are left out, unless its ``metadata.yaml`` names them, or it cannot be read.
    """
    if not bag.is_dir():
        return [bag]
    files = sorted(p for p in bag.iterdir() if p.is_file())
    hidden = {p for p in files if p.name.startswith(".")}
    if hidden:
        try:
            hidden -= set(find_files(bag, ("mcap", "sqlite3")).paths)
        except RecordError:
            return files
    return [p for p in files if p not in hidden]


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, as `sha256sum` prints it."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()


def content_hash(bag: str | Path) -> str:
    """Return the SHA-256 of a bag, whatever it is called and wherever it lies.

    Of a single file its own; of a directory that of what ``sha256sum *`` prints in it, of
    hidden ones too that are part of the record.

    Raises
    ------
    OSError
        A file cannot be read.
    """
    bag = Path(bag)
    if not bag.is_dir():
        return file_sha256(bag)
    lines = "".join(f"{file_sha256(path)}  {path.name}\n" for path in bag_files(bag))
    return hashlib.sha256(lines.encode("utf-8", "surrogateescape")).hexdigest()


def files_state(bag: str | Path) -> tuple[str, int]:
    """Return names, sizes, places and times of a bag's files as text, and the latest time (ns).

    Equal texts mean equal bytes, but for a file written twice within a tick of its clock.

    Raises
    ------
    OSError
        A file cannot be looked at.
    """
    parts, latest = [], 0
    for path in bag_files(Path(bag)):
        state = path.stat()
        changed = max(state.st_mtime_ns, state.st_ctime_ns)
        latest = max(latest, changed)
        parts.append(f"{path.name}/{state.st_size}/{state.st_ino}/{changed}")
    return "\n".join(parts), latest
