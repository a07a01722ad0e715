"""The three nodes as processes: started together, watched, and ended on every way out."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from pathlib import Path

from ema_record.errors import EmaError, UsageError
from ema_ros.process import PARENT, QUIET

ParameterValue = float | int | str

GENTLE_STOP = 4.0
"""Time for a node to close its record and end (s)."""
RESTARTS = 2
"""How often a node that was killed is started again."""
_TAIL = 64 << 10


class NodeDiedError(EmaError):
    """A node ended before the test did: there is no verdict."""

    exit_status = 4


def key(module: str, namespace: str) -> str:
    """Return how a node is called among others: its module, and its actuator's name."""
    return f"{module} of {namespace.removeprefix('/')}" if namespace else module


class Supervisor:
    """Starts nodes, each in a process group of its own; ends them when the block is left.

    Parameters
    ----------
    log : file to which the nodes' output is appended.
    """

    def __init__(self, log: Path) -> None:
        self.log = log
        self._nodes: dict[str, subprocess.Popen[bytes]] = {}
        self._started: dict[str, tuple[str, Mapping[str, ParameterValue], str]] = {}
        self._restarts: dict[str, int] = {}

    def __enter__(self) -> Supervisor:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(
        self, module: str, parameters: Mapping[str, ParameterValue], namespace: str = ""
    ) -> None:
        """Start ``python -m module`` with ROS parameters, in a namespace."""
        settings = [item for name, value in parameters.items()
                    for item in ("-p", f"{name}:={json.dumps(value, ensure_ascii=False)}")]
        if namespace:
            settings += ["-r", f"__ns:={namespace}"]
        name = key(module, namespace)
        self._started[name] = module, parameters, namespace
        if name in self._nodes:
            self._nodes[name].wait(GENTLE_STOP)  # one that runs is not replaced
        with self.log.open("ab") as log:
            self._nodes[name] = subprocess.Popen(  # noqa: S603  (our own modules)
                [sys.executable, "-m", module, *QUIET, *settings],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
                env={**os.environ, PARENT: str(os.getpid())},
            )

    def pid(self, module: str, namespace: str = "") -> int:
        """Return the process id of a node."""
        return self._nodes[key(module, namespace)].pid

    def check(self) -> None:
        """Raise the error of a node that has ended, its last line being the reason."""
        for name, process in self._nodes.items():
            status = process.poll()
            if status is None:
                continue
            line = self.last_error()
            if status == UsageError.exit_status and line:
                raise UsageError(line)
            raise NodeDiedError(
                f"{name} ended with status {status}: {line or 'it gave no reason'} "
                f"(see {self.log})"
            )

    def revive(self, module: str, namespace: str = "") -> str:
        """Start a node again that was killed, at most `RESTARTS` times; return what was done.

        A node that gave an error of its own is left to `check`.
        """
        name = key(module, namespace)
        process = self._nodes.get(name)
        status = None if process is None else process.poll()
        if status is None or status >= 0 or self._restarts.get(name, 0) >= RESTARTS:
            return ""
        self._restarts[name] = self._restarts.get(name, 0) + 1
        self.start(*self._started[name])
        return f"{name} was killed (signal {-status}) and started again"

    def last_error(self) -> str:
        """Return the last error line that a node wrote, else its last line, else nothing."""
        try:
            with self.log.open("rb") as stream:
                stream.seek(max(0, self.log.stat().st_size - _TAIL))
                lines = stream.read().decode(errors="replace").splitlines()
        except OSError:
            return ""
        errors = [line for line in lines if line.startswith("error: ")]
        return errors[-1].removeprefix("error: ") if errors else "".join(lines[-1:])[:200]

    def ask_to_end(self) -> None:
        """Ask all nodes to end, and do not wait.

        By SIGTERM, which ends one that still loads its modules without a word; SIGINT is a
        traceback there.
        """
        _ask_to_end(self._nodes.values())

    def wait_for(self, module: str) -> None:
        """Wait until the nodes of a module have ended, as long as a gentle stop may take."""
        for name, process in self._nodes.items():
            if self._started[name][0] == module:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(GENTLE_STOP)

    def stop(self, *first: str) -> None:
        """End all nodes, those of the modules named first; what does not end is killed."""
        early = {name: process for name, process in self._nodes.items()
                 if self._started[name][0] in first}
        try:
            for group in (early, self._nodes):
                _ask_to_end(group.values())
                deadline = time.monotonic() + GENTLE_STOP
                for process in group.values():
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        process.wait(max(0.0, deadline - time.monotonic()))
        finally:
            for process in self._nodes.values():
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _ask_to_end(processes: Iterable[subprocess.Popen[bytes]]) -> None:
    for process in processes:
        if process.poll() is None:
            process.terminate()
