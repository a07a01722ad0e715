"""Processes that share the simulator's runs on one unit."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, Future
from typing import TYPE_CHECKING, Any

import numpy as np

from ema_identification.actuator.runs import Case, run_case, run_cases

if TYPE_CHECKING:
    from ema_identification.actuator.features import FeatureMap
    from ema_sim.actuator import Model

FIRST = 100
"""Runs that are made here before processes are started: where nothing is missing, that is all."""
FEWEST = 2
"""Runs that are worth sharing."""
IDLE = 60
"""Time (s) after which a process that has nothing to do ends."""


class Processes:
    """Runs made here or, once there are many, on several processes; the same bits either way."""

    def __init__(self, workers: int = 1) -> None:
        self.workers, self._made = workers, 0
        self._loads: list[Future[int]] = []

    def run(self, model: Model, cases: Sequence[Case], fmap: FeatureMap) -> np.ndarray:
        """Return the features of `cases`, shape (n, d)."""
        self._made += len(cases)
        if self.workers == 1 or len(cases) < FEWEST or not self._ready():
            return np.array([run_case(model, case, fmap) for case in cases])
        ends = np.linspace(0, len(cases), min(self.workers, len(cases)) + 1).astype(int)
        try:
            executor = self._executor()
            parts = [executor.submit(run_cases, model, cases[a:b], fmap)
                     for a, b in zip(ends[:-1], ends[1:])]
            return np.concatenate([part.result() for part in parts])
        except BrokenExecutor:  # a process was killed, for want of memory perhaps
            self.workers = 1
            return self.run(model, cases, fmap)

    @property
    def starting(self) -> bool:
        """Whether the processes were asked for."""
        return bool(self._loads)

    @property
    def started(self) -> bool:
        """Whether they are there."""
        return self.starting and all(load.done() for load in self._loads)

    def _ready(self) -> bool:
        """Return `started`; ask for the processes, without waiting for them, when that is due."""
        if not self.starting and self._made >= FIRST:
            executor = self._executor()
            self._loads = [executor.submit(_load) for _ in range(self.workers)]
        return self.started

    def _executor(self) -> Any:
        # That of joblib, which has just built a library on the same processes.
        from joblib.externals.loky import get_reusable_executor

        return get_reusable_executor(max_workers=self.workers, timeout=IDLE)


def _load() -> int:
    """Import what a run needs, on a process."""
    import ema_sim.simulate

    return len(ema_sim.simulate.__name__)
