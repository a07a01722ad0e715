"""The three nodes as processes: started together, watched, and ended on every way out."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

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


class Supervisor:
    """Starts nodes, each in a process group of its own; ends them when the block is left.

    Parameters
    ----------
    log : file to which the nodes' output is appended.
    """

    def __init__(self, log: Path) -> None:
        """Begin without nodes."""
        self.log = log
        self._nodes: dict[str, subprocess.Popen[bytes]] = {}
        self._parameters: dict[str, Mapping[str, ParameterValue]] = {}
        self._restarts: dict[str, int] = {}

    def __enter__(self) -> Supervisor:
        """Return the supervisor itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """End all nodes."""
        self.stop()

    def start(self, module: str, parameters: Mapping[str, ParameterValue]) -> None:
        """Start ``python -m module`` with ROS parameters."""
        settings = [item for name, value in parameters.items()
                    for item in ("-p", f"{name}:={json.dumps(value, ensure_ascii=False)}")]
        self._parameters[module] = parameters
        if module in self._nodes:
            self._nodes[module].wait(GENTLE_STOP)  # one that runs is not replaced
        with self.log.open("ab") as log:
            self._nodes[module] = subprocess.Popen(  # noqa: S603  (our own modules)
                [sys.executable, "-m", module, *QUIET, *settings],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
                env={**os.environ, PARENT: str(os.getpid())},
            )

    def pid(self, module: str) -> int:
        """Return the process id of a node."""
        return self._nodes[module].pid

    def check(self) -> None:
        """Raise the error of a node that has ended, its last line being the reason."""
        for module, process in self._nodes.items():
            status = process.poll()
            if status is None:
                continue
            line = self.last_error()
            if status == UsageError.exit_status and line:
                raise UsageError(line)
            raise NodeDiedError(
                f"{module} ended with status {status}: {line or 'it gave no reason'} "
                f"(see {self.log})"
            )

    def revive(self, module: str) -> str:
        """Start a node again that was killed, at most `RESTARTS` times; return what was done.

        A node that gave an error of its own is left to `check`.
        """
        process = self._nodes.get(module)
        status = None if process is None else process.poll()
        if status is None or status >= 0 or self._restarts.get(module, 0) >= RESTARTS:
            return ""
        self._restarts[module] = self._restarts.get(module, 0) + 1
        self.start(module, self._parameters[module])
        return f"{module} was killed (signal {-status}) and started again"

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

    def stop(self, *first: str) -> None:
        """End all nodes, those named before the others; what does not end is killed."""
        early = {name: self._nodes[name] for name in first if name in self._nodes}
        try:
            for group in (early, self._nodes):
                for process in group.values():
                    if process.poll() is None:
                        process.send_signal(signal.SIGINT)
                deadline = time.monotonic() + GENTLE_STOP
                for process in group.values():
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        process.wait(max(0.0, deadline - time.monotonic()))
        finally:
            for process in self._nodes.values():
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
