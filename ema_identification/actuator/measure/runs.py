"""Simulated runs and their features on several processes, kept part by part."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.recorder import whole
from ema_identification.actuator.measure.tolerances import N_TOLERANCES, RecordConditions, realise
from ema_record import array_cache as cache
from ema_record.errors import InvalidRecordError, SimulationError
from ema_record.kit import with_present_kit
from ema_sim.drives import shows_carrier
from ema_sim.effects import Effects
from ema_sim.machine import TURN
from ema_sim.model_file import Model
from ema_sim.simulate import simulate

CHUNK = 8
"""Runs a job."""
Progress = Callable[[str, float], None]
"""Called with what is being done and how much of it is (0 to 1)."""


def silent(_what: str, _share: float) -> None:
    """Show no progress."""


class UnitRun(NamedTuple):
    """One run of the nominal unit."""

    start_angle: float
    seed: int
    effects: Effects | None = None
    """In place of those of the model."""


def run_case(model: Model, case: UnitRun, fmap: FeatureMap) -> np.ndarray:
    """Return the features of a case, shape (d,); NaN where it left the simulator's domain."""
    actuator, effects = realise(
        model, np.zeros(N_TOLERANCES), RecordConditions(start_angle=case.start_angle),
        case.effects)
    # The case holds what the sensor of the rotor angle reads.
    angle = case.start_angle - effects.hall_misalignment.angle
    try:
        return fmap.extract(whole(simulate(
            fmap.profile, actuator=actuator, effects=effects, seed=case.seed,
            rate=fmap.rate, start_angle=angle % TURN,
            switching=shows_carrier(actuator, fmap.rate),
        ), model.actuator))
    except (SimulationError, InvalidRecordError):  # the latter: nothing to rebuild from
        return np.full(len(fmap.features), np.nan)


def _chunk(model: Model, cases: Sequence[UnitRun], fmap: FeatureMap) -> np.ndarray:
    return np.array([run_case(model, case, fmap) for case in cases])


def run_cases(
    model: Model, cases: Sequence[UnitRun], fmap: FeatureMap, *, workers: int = 1,
    progress: Progress = silent, what: str = "runs", keep: str = "",
) -> np.ndarray:
    """Return the features of many cases, shape (n, d); the same for any number of workers."""
    chunks = [cases[i:i + CHUNK] for i in range(0, len(cases), CHUNK)]
    return np.concatenate(spread_out(
        _chunk, [(model, chunk, fmap) for chunk in chunks], workers=workers, progress=progress,
        what=what, keep=keep))


def spread_out(
    function: Callable[..., np.ndarray], arguments: Sequence[tuple[object, ...]], *, workers: int,
    progress: Progress = silent, what: str = "runs", keep: str = "",
) -> list[np.ndarray]:
    """Return ``function(*a)`` for each of `arguments`, in order, with the present kit, one thread.

    `keep` : name under which each part is kept in the cache as it is done; a call that was
    stopped goes on there. Whoever has kept the whole removes the parts (`array_cache.forget`).
    """
    stored = [cache.load(f"{keep}_{k}") for k in range(len(arguments))] if keep else []
    found = {k: one["rows"] for k, one in enumerate(stored) if one is not None}
    missing = [k for k in range(len(arguments)) if k not in found]

    if found:
        progress(what, len(found) / len(arguments))

    def results() -> Iterator[np.ndarray]:
        if workers == 1 or len(missing) < 2:
            with threadpool_limits(limits=1):
                yield from (function(*arguments[k]) for k in missing)
            return
        from joblib import Parallel, delayed

        done = delayed(with_present_kit(_on_one_thread))
        yield from Parallel(n_jobs=workers, return_as="generator")(
            done(function, *arguments[k]) for k in missing)

    for k, result in zip(missing, results()):
        found[k] = result
        if keep:
            cache.save(f"{keep}_{k}", {"rows": result})
        progress(what, len(found) / len(arguments))
    return [found[k] for k in range(len(arguments))]


def _on_one_thread(function: Callable[..., np.ndarray], *arguments: object) -> np.ndarray:
    with threadpool_limits(limits=1):
        return function(*arguments)
