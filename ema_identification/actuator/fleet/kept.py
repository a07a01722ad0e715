"""What healthy units of a library leave: made once, kept in the kit's `library/` or in the cache.

It stands under a hash of the libraries that it is of. The code is not in the name: where other
code made it, the first units judge whether the present one would make the same.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from ema_identification.actuator.fleet.surrogate import FleetLibrary
from ema_identification.actuator.measure.runs import Progress, silent
from ema_record import array_cache as cache
from ema_record.kit import LIBRARY, kit_path

T = TypeVar("T")
AGAIN, ALIKE = 3, 0.01
"""Units whose numbers are made again of what other code kept; their relative error."""
MADE_BY = "ema_identification.actuator.workflow"
"""What healthy units leave depends on what this module imports."""


def kept_arrays(
    libraries: Sequence[FleetLibrary], what: str, make: Callable[[], Mapping[str, np.ndarray]],
    agrees: Callable[[Mapping[str, np.ndarray]], bool], folder: Path | None = None,
) -> Mapping[str, np.ndarray]:
    """Return arrays that belong to libraries, from where they are kept, else made now.

    Parameters
    ----------
    libraries : whose arrays they are.
    what : begin of their name.
    make : makes them.
    agrees : whether the present code would make those that other code kept; asked once.
    folder : where new ones are kept, default the cache.
    """
    digest = hashlib.sha256(b"".join(
        np.ascontiguousarray(x).tobytes() for library in libraries
        for x in (library.weights, library.aside[1], library.healthy)))
    name, code = f"{what}_{digest.hexdigest()[:32]}", cache.key_of(module=MADE_BY)
    for place in (kit_path(LIBRARY), None):
        kept = cache.load(name, place)
        if kept is None or "made_by" not in kept:
            continue
        marker = f"agreed_{cache.key_of(name, str(kept['made_by']), module=MADE_BY)}"
        if str(kept["made_by"]) == code or cache.load(marker) is not None:
            return kept
        if agrees(kept):
            cache.save(marker, {"agreed": np.array(True)})
            return kept
    made = make()
    cache.save(name, {**made, "made_by": np.array(code)}, folder)
    return made


def kept_of(
    libraries: Sequence[FleetLibrary], what: str, units: Sequence[T],
    scored: Callable[[T], tuple[float, ...]], folder: Path | None = None, *,
    progress: Progress = silent,
) -> np.ndarray:
    """Return what healthy units of several libraries leave, shape (n, numbers of `scored`)."""
    def agrees(kept: Mapping[str, np.ndarray]) -> bool:
        return "rows" in kept and len(kept["rows"]) == len(units) and np.allclose(
            [scored(unit) for unit in units[:AGAIN]], kept["rows"][:AGAIN], rtol=ALIKE)

    def make() -> dict[str, np.ndarray]:
        rows = []
        for unit in units:
            rows.append(scored(unit))
            progress("healthy units of these tests", len(rows) / len(units))
        return {"rows": np.array(rows)}

    return kept_arrays(libraries, what, make, agrees, folder)["rows"]
