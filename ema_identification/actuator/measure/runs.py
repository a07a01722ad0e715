"""Simulated runs and their features, several at a time in threads.

Simulated runs as feature vectors, one after another or on several processes.

Simulated runs on one unit, several at a time in threads.

Compiled code, FFTs and random numbers leave the interpreter's lock, so that two threads do nearly
the work of two processes; nothing has to be started, sent, or restarted when it dies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.signals import TURN
from ema_identification.actuator.measure.tolerances import Conditions, realise
from ema_record.errors import SimulationError
from ema_record.record import Record
from ema_sim.effects import Effects
from ema_sim.model_file import Model
from ema_sim.simulate import simulate

CHUNK = 8
"""Runs a job."""
Progress = Callable[[str, float], None]
"""Called with what is being done and how much of it is (0 to 1)."""


def silent(_what: str, _share: float) -> None:
    """Show no progress."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One run."""

    z: np.ndarray
    """Tolerances in half widths."""
    conditions: Conditions
    seed: int
    effects: Effects | None = None
    """In place of those of the model."""


def simulate_case(model: Model, case: Case, fmap: FeatureMap) -> Record:
    """Return the record of a case."""
    actuator, effects = realise(model, case.z, case.conditions, case.effects)
    # The conditions hold what the sensor of the rotor angle reads.
    angle = case.conditions.start_angle - effects.hall_misalignment.angle
    return simulate(
        fmap.profile, actuator=actuator, effects=effects, seed=case.seed,
        noise=case.conditions.noise, rate=fmap.rate, start_angle=angle % TURN,
    )


def run_case(model: Model, case: Case, fmap: FeatureMap) -> np.ndarray:
    """Return the features of a case, shape (d,); NaN where it left the simulator's domain."""
    try:
        return fmap.extract(simulate_case(model, case, fmap))
    except SimulationError:
        return np.full(len(fmap.features), np.nan)


def _chunk(model: Model, cases: Sequence[Case], fmap: FeatureMap) -> np.ndarray:
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        return np.array([run_case(model, case, fmap) for case in cases])


def run_cases(
    model: Model, cases: Sequence[Case], fmap: FeatureMap, *, workers: int = 1,
    progress: Progress = silent, what: str = "runs",
) -> np.ndarray:
    """Return the features of many cases, shape (n, d); the same for any number of workers."""
    chunks = [cases[i:i + CHUNK] for i in range(0, len(cases), CHUNK)]
    return np.concatenate(list(spread_out(
        _chunk, [(model, chunk, fmap) for chunk in chunks], workers=workers, progress=progress,
        what=what)))


def spread_out(
    function: Callable[..., np.ndarray], arguments: Sequence[tuple[object, ...]], *, workers: int,
    progress: Progress = silent, what: str = "runs",
) -> list[np.ndarray]:
    """Return ``function(*a)`` for each of `arguments`, in order."""
    found: list[np.ndarray] = []
    if workers == 1:
        for k, argument in enumerate(arguments):
            found.append(function(*argument))
            progress(what, (k + 1) / len(arguments))
        return found
    from joblib import Parallel, delayed

    for k, result in enumerate(Parallel(n_jobs=workers, return_as="generator")(
            delayed(function)(*argument) for argument in arguments)):
        found.append(result)
        progress(what, (k + 1) / len(arguments))
    return found


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
