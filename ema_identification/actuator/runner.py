"""Simulated runs on one unit, several at a time in threads.

Compiled code, FFTs and random numbers leave the interpreter's lock, so that two threads do nearly
the work of two processes; nothing has to be started, sent, or restarted when it dies.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ema_identification.actuator.runs import Case, run_case

if TYPE_CHECKING:
    from ema_identification.actuator.features import FeatureMap
    from ema_sim.actuator import Model


class Runner:
    """Makes runs in threads; the same bits for any number of them."""

    def __init__(self, workers: int = 1) -> None:
        self._threads = ThreadPoolExecutor(workers, "runs") if workers > 1 else None

    def run(self, model: Model, cases: Sequence[Case], fmap: FeatureMap) -> np.ndarray:
        """Return the features of `cases`, shape (n, d)."""
        job = partial(run_case, model, fmap=fmap)
        if self._threads is None or len(cases) == 1:
            return np.array([job(case) for case in cases])
        return np.array(list(self._threads.map(job, cases)))
