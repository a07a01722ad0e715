"""Simulated runs as feature vectors, one after another or on several processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.actuator.features import FeatureMap
from ema_identification.actuator.lines import TURN
from ema_identification.actuator.spread import Conditions, realise
from ema_record.errors import SimulationError
from ema_record.record import Record
from ema_sim.actuator import Model
from ema_sim.effects import Effects
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
        noise=case.conditions.noise, start_angle=angle % TURN,
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
