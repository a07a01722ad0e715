"""Files that appear whole or not at all, and never over another one."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ema_record.errors import OutputError

REMOVAL_STEPS = 10
"""How often a directory is made again that goes on being removed."""


def make_new_directory(path: Path) -> None:
    """Make a directory, and those above it; one that exists is never touched.

    Raises
    ------
    OutputError
        It exists, or cannot be made.

    """
    try:
        path.mkdir(parents=True)
    except FileExistsError:
        raise exists(path) from None
    except OSError as error:
        raise cannot_write(path, error) from None


def exists(path: Path) -> OutputError:
    """Return the error for an output that is there already."""
    return OutputError(f"{path}: exists and is never overwritten: choose another name")


def cannot_write(path: Path, error: OSError) -> OutputError:
    """Return the error for an output that cannot be written."""
    return OutputError(
        f"{path}: cannot be written ({error.strerror or error}): choose a folder with write "
        "permission and free space"
    )


def sync_directory(path: Path) -> None:
    """Make the names in a directory durable."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def put_back(path: Path, descriptor: int) -> bool:
    """Give a file that was removed while it is being written its name back.

    Its bytes live as long as it is open. They are copied to a new file under the same name,
    the directory being made again, and `descriptor` goes on writing there.

    Returns
    -------
    bool
        Whether it had been removed.

    Raises
    ------
    OSError
        It cannot be put back.

    """
    if os.fstat(descriptor).st_nlink > 0:
        return False
    with Path(f"/proc/self/fd/{descriptor}").open("rb") as old, _made_again(path) as new:
        shutil.copyfileobj(old, new)
        new.flush()
        os.dup2(new.fileno(), descriptor)
    return True


def _made_again(path: Path) -> BinaryIO:
    """Open a new file in a directory that may still be in the middle of its removal."""
    for _ in range(REMOVAL_STEPS):
        path.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileNotFoundError):
            return path.open("xb")
    return path.open("xb")


@contextlib.contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path` to write to; it is renamed on success.

    Raises
    ------
    OutputError
        `path` exists, or cannot be written.

    """
    if path.exists():
        raise exists(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
        sync_directory(path.parent)
    except OSError as error:
        raise cannot_write(path, error) from None
    finally:
        with contextlib.suppress(OSError):  # there is none where it could not be made
            temporary.unlink(missing_ok=True)
