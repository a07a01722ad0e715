"""Files that appear whole or not at all and never over another one; files read with a bound."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator
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


def check_apart(*outputs: Path | None) -> None:
    """Raise OutputError where two outputs have one name."""
    given = [path.resolve() for path in outputs if path is not None]
    for path in given:
        if given.count(path) > 1:
            raise OutputError(f"{path}: two results in one place: give each a name of its own")


def exists(path: Path) -> OutputError:
    """Return the error for an output that is there already."""
    return OutputError(f"{path}: exists and is never overwritten: choose another name")


def cannot_write(path: Path, error: OSError) -> OutputError:
    """Return the error for an output that cannot be written."""
    remedy = ("make its folder first" if isinstance(error, FileNotFoundError)
              else "choose a shorter name" if error.errno == errno.ENAMETOOLONG
              else "choose a folder with write permission and free space")
    return OutputError(f"{path}: cannot be written ({error.strerror or error}): {remedy}")


def sync_directory(path: Path) -> None:
    """Make the names in a directory durable."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def put_back(path: Path, descriptor: int) -> bool:
    """Give a file that was removed while it is being written its name back; return if it was.

    Its bytes live as long as it is open. They are copied to a new file under the same name,
    the directory being made again, and `descriptor` goes on writing there.

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
def new_file(path: Path, is_own: Callable[[Path], bool] = lambda _: False) -> Iterator[Path]:
    """Give an empty temporary file beside `path` to write to; it gets that name on success.

    Only a file for which `is_own` holds is replaced; whatever else takes the name meanwhile
    stays as it is.

    Raises
    ------
    OutputError
        `path` exists, or cannot be written.
    """
    if os.path.lexists(path) and not is_own(path):
        raise exists(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}.tmp")
    try:
        temporary.touch(exist_ok=False)
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        if is_own(path):
            temporary.replace(path)
        else:
            _give_name(temporary, path)
        sync_directory(path.parent)
    except FileExistsError:
        raise exists(path) from None
    except OSError as error:
        raise cannot_write(path, error) from None
    finally:
        with contextlib.suppress(OSError):  # there is none where it could not be made
            temporary.unlink(missing_ok=True)


def _give_name(temporary: Path, path: Path) -> None:
    """Give a file a name that is free; FileExistsError where it is not."""
    try:
        os.link(temporary, path)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.EOPNOTSUPP):
            raise
        path.touch(exist_ok=False)  # a file system without links: the name first, then the file
        temporary.replace(path)


def read_bounded(path: Path, limit: int) -> bytes:
    """Return what a regular file of at most `limit` bytes holds.

    Its kind is looked at and its bytes are counted after it was opened, so neither a pipe nor
    a device nor a file that grows is waited for or read beyond the limit.

    Raises
    ------
    OSError
        It cannot be read, is no regular file, or is larger.
    """
    def without_waiting(name: str, flags: int) -> int:
        return os.open(name, flags | os.O_NONBLOCK)

    if "\0" in str(path):  # of a name in a file; Python raises ValueError
        raise OSError(errno.EINVAL, "a zero byte in the name")
    with open(path, "rb", opener=without_waiting) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file")
        data = file.read(limit + 1)
    if len(data) > limit:
        raise OSError(errno.EFBIG, f"at most {limit} bytes are read, it has more")
    return data


@contextlib.contextmanager
def locked(path: Path, busy: str) -> Iterator[None]:
    """Keep other processes from what the file `path`, made where it is not there, stands for.

    OutputError with the text `busy` where another one has it.
    """
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise OutputError(busy) from None
        yield
