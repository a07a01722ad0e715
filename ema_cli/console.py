"""What all commands share: terminals, JSON output, progress bars, errors as one line.

Results go to standard output, everything else (progress, notes, errors) to standard error,
so that ``--json`` can be piped. rich is imported on first use.
"""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from ema_record.errors import EmaError

if TYPE_CHECKING:
    from rich.console import Console

Item = TypeVar("Item")

WRONG_USE = 2
INTERNAL_ERROR = 70
INTERRUPTED = 128 + signal.SIGINT
PIPE_CLOSED = 128 + signal.SIGPIPE
TRACEBACK_VARIABLE = "EMA_TRACEBACK"
"""Set to 1 to see the traceback of an internal error."""


def stdout() -> Console:
    """Return the console of results."""
    from rich.console import Console

    return Console(highlight=False)


def stderr() -> Console:
    """Return the console of notes, progress and errors."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def note(text: str) -> None:
    """Print one line for the person at the terminal, to standard error."""
    print(text, file=sys.stderr, flush=True)


def print_json(value: object) -> None:
    """Print `value` as one line of JSON; numbers that are not finite become null."""
    print(json.dumps(_plain(value), allow_nan=False, ensure_ascii=False), flush=True)


def _plain(value: object) -> object:
    """Return `value` in types that JSON knows."""
    if isinstance(value, dict):
        return {str(name): _plain(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if hasattr(value, "tolist"):  # numpy
        return _plain(value.tolist())
    return str(value)


@contextlib.contextmanager
def progress(description: str, total: float | None = None) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on standard error, if that is a terminal.

    Parameters
    ----------
    description : str
        What takes the time.
    total : float, optional
        The value at which it is done; None shows that it is alive.

    Yields
    ------
    callable
        Takes how much is done by now, in the unit of `total`.

    """
    if not sys.stderr.isatty():
        yield lambda _done: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=stderr(), transient=True) as bar:
        task = bar.add_task(description, total=total)
        yield lambda done: bar.update(task, completed=done)


@contextlib.contextmanager
def progress_of(description: str) -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar that also says what goes on, as `progress` does.

    Yields
    ------
    callable
        Takes what goes on and how much of the whole is done, 0 to 1.

    """
    if not sys.stderr.isatty():
        yield lambda _what, _part: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=stderr(), transient=True) as bar:
        task = bar.add_task(description, total=1.0)
        yield lambda what, part: bar.update(task, description=what, completed=part)


def track(items: Iterable[Item], description: str, total: int) -> Iterator[Item]:
    """Yield `items`, `total` of them, with a progress bar."""
    with progress(description, total) as advance:
        for index, item in enumerate(items):
            yield item
            advance(index + 1)


def error_line(text: str) -> None:
    """Print an error as one line on standard error."""
    with contextlib.suppress(OSError, ValueError):
        print("ema: " + " ".join(text.split()), file=sys.stderr, flush=True)


def guarded(command: Callable[[], int]) -> int:
    """Run `command` and return its exit status; whatever goes wrong becomes one line.

    EmaError gives its own status, an error of the operating system 2, Ctrl-C 130, a closed
    pipe 141, anything else (an error in this software) 70.
    """
    try:
        status = command()
        sys.stdout.flush()
    except EmaError as error:
        error_line(str(error))
        return error.exit_status
    except KeyboardInterrupt:
        error_line("interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        return _pipe_closed()
    except OSError as error:
        if error.errno == errno.EPIPE:
            return _pipe_closed()
        where = f"{error.filename}: " if error.filename is not None else ""
        error_line(f"{where}{error.strerror or error}: {_remedy(error)}")
        return WRONG_USE
    except MemoryError:
        error_line("not enough memory: close other programs or use a smaller record")
        return WRONG_USE
    except ModuleNotFoundError as error:
        error_line(_missing_module(str(error.name)))
        return WRONG_USE
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        error_line(
            f"internal error ({type(error).__name__}: {str(error)[:200]}): set "
            f"{TRACEBACK_VARIABLE}=1 to see where, and report it"
        )
        return INTERNAL_ERROR
    return status


def leave(status: int) -> NoReturn:
    """End the process with `status`, whatever the state of standard output."""
    try:
        sys.stdout.flush()
    except OSError:
        status = _pipe_closed()
    sys.exit(status)


def _pipe_closed() -> int:
    """Let Python's shutdown flush into nothing, and return the status."""
    with contextlib.suppress(OSError, ValueError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, sys.stdout.fileno())
        os.close(nothing)
    return PIPE_CLOSED


_REMEDIES = {
    errno.EACCES: "change its permissions or choose another place",
    errno.EPERM: "change its permissions or choose another place",
    errno.EROFS: "choose a place that can be written to",
    errno.ENOSPC: "free some disk space or choose another disk",
    errno.EDQUOT: "free some disk space or choose another disk",
    errno.ENOENT: "check the name",
    errno.ENOTDIR: "a part of the path is no folder, check the name",
    errno.EISDIR: "it is a folder, give a file",
    errno.ENAMETOOLONG: "choose a shorter name",
}


def _remedy(error: OSError) -> str:
    return _REMEDIES.get(error.errno or 0, "check the file and the disk")


_ROS_MODULES = frozenset(
    {"rclpy", "std_msgs", "sensor_msgs", "geometry_msgs", "trajectory_msgs", "diagnostic_msgs",
     "builtin_interfaces", "rcl_interfaces"}
)


def _missing_module(name: str) -> str:
    package = name.split(".")[0]
    if package in _ROS_MODULES:
        return (
            f"this command needs ROS 2 (no module {package!r}): pip install 'ema_phm[ros]', or "
            "source the setup.bash of a ROS installation"
        )
    return f"the Python module {name!r} is not installed: pip install it, or run 'make bit' again"


def check_new(*paths: Any) -> None:
    """Raise OutputError if one of the outputs exists; called before the work begins."""
    from pathlib import Path

    from ema_record.files import exists

    for path in paths:
        if path is not None and (Path(path).exists() or Path(path).is_symlink()):
            raise exists(Path(path))
