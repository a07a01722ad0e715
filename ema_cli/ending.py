"""How a command ends: its exit status, and whatever goes wrong as one line."""

from __future__ import annotations

import contextlib
import errno
import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator
from typing import NoReturn

from ema_cli.console import WRONG_USE, error_line
from ema_record.errors import EmaError
from ema_ros.process import InterruptionError

INTERNAL_ERROR = 70
INTERRUPTED = 128 + signal.SIGINT
PIPE_CLOSED = 128 + signal.SIGPIPE
TERMINATED = 128 + signal.SIGTERM
TRACEBACK_VARIABLE = "EMA_TRACEBACK"
"""Set to 1 to see the traceback of an internal error."""


class TerminatedError(KeyboardInterrupt):
    """The process is asked to end; what it does is left as by Ctrl-C."""


def end_quietly() -> None:
    """Let SIGTERM end this process as Ctrl-C does: children ended, nothing half-written."""

    def end(*_: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # once is enough
        raise TerminatedError

    def interrupt(*_: object) -> None:
        raise InterruptionError

    signal.signal(signal.SIGTERM, end)
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # a job in the background
        signal.signal(signal.SIGINT, interrupt)


@contextlib.contextmanager
def held_signals() -> Iterator[Callable[[], None]]:
    """Hold SIGINT, SIGTERM and SIGHUP back; yield what raises the first that has come, if any.

    They tear apart neither a call of the middleware, nor the start of a process, nor the loading
    of a module, which make other errors of them. What has come by the end is raised there:
    TerminatedError after SIGTERM, else KeyboardInterrupt.
    """
    come: list[int] = []

    def check() -> None:
        if come:
            raise TerminatedError if come[0] == signal.SIGTERM else InterruptionError

    before = {number: signal.getsignal(number)
              for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    heard = [number for number, handler in before.items() if handler != signal.SIG_IGN]
    for number in heard:
        signal.signal(number, lambda number, _: come.append(number))
    try:
        yield check
    finally:
        for number in heard:
            signal.signal(number, before[number])
    check()


def guarded(command: Callable[[], int]) -> int:
    """Run `command` and return its exit status; whatever goes wrong becomes one line.

    EmaError gives its own status, an error of the operating system 2, Ctrl-C 130, SIGTERM 143,
    a closed pipe 141, anything else (an error in this software) 70.
    """
    try:
        status = command()
        sys.stdout.flush()
    except EmaError as error:
        error_line(str(error))
        return error.exit_status
    except TerminatedError:
        error_line("terminated")
        return TERMINATED
    except KeyboardInterrupt:
        error_line("interrupted")
        return INTERRUPTED
    except SystemExit as leaving:
        if isinstance(leaving.__context__, BrokenPipeError):  # rich then leaves with status 1
            return _pipe_closed()
        raise
    except OSError as error:
        if error.errno == errno.EPIPE:
            return _pipe_closed()
        where = f"{error.filename}: " if error.filename is not None else ""
        error_line(f"{where}{error.strerror or error}: "
                   f"{_REMEDIES.get(error.errno or 0, 'check the file and the disk')}")
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
    except OSError as error:  # what could not be written is dropped, what it means was said
        closed = _pipe_closed()
        status = closed if error.errno == errno.EPIPE else status or WRONG_USE
    gc.freeze()  # all is left to the system: looking through it once more takes 0.2 s
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
