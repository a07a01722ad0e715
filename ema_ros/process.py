"""The life of a node's process: environment, signals, one-line errors, exit status.

The client library is handed in by the node, so that nothing here needs ROS.
"""

from __future__ import annotations

import ctypes
import faulthandler
import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeVar

from ema_record.errors import EmaError, UsageError

T = TypeVar("T")
PARENT = "EMA_PHM_PARENT"
"""Environment variable: id of the process with which this one is to end."""
LAST_DOMAIN = 232
"""The next one's ports are beyond 65535."""
SPIN_PERIOD = 0.1
"""Longest wait of the executor before it looks at signals again (s)."""
QUIET = ["--ros-args", "--disable-external-lib-logs"]
"""Arguments of a node that leaves no log files in the home directory."""
SHUT_DOWN = 2.0
"""Longest wait for what is left to do when the process is to end (s)."""
MIDDLEWARE_END = 5
"""Longest wait for the middleware to end (s); then the process ends without it."""
_PR_SET_PDEATHSIG = 1


def report(line: str) -> None:
    """Write one line to stderr."""
    sys.stderr.write(line + "\n")
    sys.stderr.flush()


def prepare_environment() -> None:
    """Let the client library find its interfaces where wheels installed it.

    Raises
    ------
    UsageError
        The environment names a domain that has no ports.
    """
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if domain not in map(str, range(LAST_DOMAIN + 1)):
        raise UsageError(
            f"ROS_DOMAIN_ID is {domain!r}: a ROS domain is a number from 0 to {LAST_DOMAIN}")
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)


class InterruptionError(KeyboardInterrupt):
    """The process is to end; of a type of its own.

    After a plain KeyboardInterrupt in code that is made of text, as that of a dataclass, Python's
    ``-m`` ends by SIGINT, whatever became of it.
    """


class StopSignal:
    """Set by SIGINT or SIGTERM.

    While `gentle` the handlers do nothing else, so that no work is torn apart; before that,
    while the node is being made, they interrupt it.
    """

    def __init__(self) -> None:
        self.number = 0
        self.gentle = False

    def __bool__(self) -> bool:
        return self.number != 0

    def install(self) -> None:
        """Take over SIGINT and SIGTERM."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, _: FrameType | None) -> None:
        self.number = number
        if not self.gentle:
            raise InterruptionError


def end_with_parent() -> None:
    """End this process when the one named by `PARENT` ends, however that happens (Linux)."""
    parent = os.environ.get(PARENT, "")
    if not parent.isdigit():
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):
        os.kill(os.getpid(), signal.SIGTERM)


def bound_the_end() -> None:
    """End this process with status 1 after `MIDDLEWARE_END`, whatever its threads wait for.

    Fast DDS can deadlock while it destroys a reader (its issues 6193 and 6502), and then inside
    a call that holds the interpreter. The watchdog of the standard library needs no interpreter;
    it writes to stderr where each thread stood. It ends with the interpreter, after which the
    middleware destroys what is static: from then on the alarm of the system is left. Only the
    first call counts.
    """
    if signal.getitimer(signal.ITIMER_REAL)[0] > 0.0:
        return
    faulthandler.dump_traceback_later(MIDDLEWARE_END, exit=True)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(MIDDLEWARE_END + 1)


@contextmanager
def spun(ros: Any, make_nodes: Callable[[Any], Sequence[T]]) -> Iterator[Sequence[T]]:
    """Yield nodes with one executor, in a context that leaves the signals to the caller.

    Parameters
    ----------
    ros : the client library, the module ``rclpy``.
    make_nodes : returns them, made in the context that it is given.
    """
    prepare_environment()
    context = ros.Context()
    ros.init(context=context, args=QUIET,
             signal_handler_options=ros.signals.SignalHandlerOptions.NO)
    nodes: Sequence[Any] = make_nodes(context)
    executor = ros.executors.SingleThreadedExecutor(context=context)
    for node in nodes:
        executor.add_node(node)
    try:
        yield nodes
    finally:
        executor.shutdown(timeout_sec=1.0)
        for node in nodes:
            node.destroy_node()
        ros.try_shutdown(context=context)


def run_node(ros: Any, make_node: Callable[[StopSignal], Any]) -> int:
    """Run one node until it is told to stop; return the exit status of the process.

    Parameters
    ----------
    ros : the client library, the module ``rclpy``.
    make_node : takes the stop signal, returns the node, whose callbacks run in this thread.
        Its ``shut_down()`` is called while it still has its executor, its ``exit_status`` is
        returned. From then on the end is bounded: the caller is to leave the process.
    """
    stop = StopSignal()
    try:
        prepare_environment()
        stop.install()
        end_with_parent()
        ros.init(signal_handler_options=ros.signals.SignalHandlerOptions.NO)
    except (UsageError, RuntimeError, ValueError) as error:  # domain, arguments of the library
        if stop:
            return 0
        report(f"error: {(str(error).splitlines() or [''])[0]}")
        return 2
    except KeyboardInterrupt:
        return 0
    node = None
    try:
        gc.disable()
        node = make_node(stop)
        gc.freeze()  # what was loaded stays: looking through it holds a node up for 100 ms
        gc.enable()
        stop.gentle = True
        executor = ros.executors.SingleThreadedExecutor()
        executor.add_node(node)
        while not stop and node.exit_status is None:
            executor.spin_once(timeout_sec=SPIN_PERIOD)
        node.shut_down()
        bound_the_end()
        executor.remove_node(node)
        for _ in range(2):  # the executor lets go of the node
            executor.spin_once(timeout_sec=0.5 * SPIN_PERIOD)
        executor.shutdown(timeout_sec=SHUT_DOWN)
        return node.exit_status or 0
    except (KeyboardInterrupt, ros.executors.ExternalShutdownException):
        return 0
    except EmaError as error:
        report(f"error: {error}")
        return error.exit_status
    except Exception:
        if stop and not stop.gentle:  # the library made it of the interruption of a call
            return 0
        raise
    finally:
        bound_the_end()
        if node is not None:
            node.destroy_node()
        ros.try_shutdown()
        gc.freeze()  # the interpreter ends without looking through all again
