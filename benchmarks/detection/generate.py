"""Generate the held-out fleet's features once, on a few processes."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed

from benchmarks.detection.fleet import Case, draw, features_of

COUNTS = {
    "healthy": 1500, "turn_short": 300, "rotor_eccentricity": 300, "motor_friction": 150,
    "surface_friction": 150, "backlash": 150, "pair": 200, "stranger": 190, "sensor": 66,
}


class Tested(NamedTuple):
    """One unit: acceptance test, later test, and what the later one has."""

    case: Case
    base: dict[str, float] | None
    later: dict[str, float] | None


def _run(jobs: list[tuple[str, int]]) -> list[Tested]:
    from threadpoolctl import threadpool_limits

    found = []
    with threadpool_limits(limits=1):
        for group, seed in jobs:
            actuator, first, case = draw(group, seed)
            found.append(Tested(case, features_of(actuator, first), features_of(actuator, case)))
    return found


def generate(
    part: float = 1.0, *, jobs: int = 2, progress: Callable[[int], None] = lambda _: None
) -> list[Tested]:
    """Return the fleet; `part` of `COUNTS`, at least 10 a group."""
    todo = [(g, 100_000 * i + n) for i, (g, count) in enumerate(COUNTS.items())
            for n in range(max(10, round(count * part)))]
    order = np.random.default_rng(5).permutation(len(todo))
    todo = [todo[k] for k in order]
    parts = [todo[k:k + 8] for k in range(0, len(todo), 8)]
    found: list[Tested] = []
    for chunk in Parallel(n_jobs=jobs, return_as="generator")(delayed(_run)(p) for p in parts):
        found += chunk
        progress(len(found))
    return found
