"""Several records of one unit as one: its own numbers shared, those of the day each for itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag

from ema_identification.actuator.decision.fit import PRIOR, TestedUnit
from ema_identification.actuator.fleet.kept import kept_of
from ema_identification.actuator.fleet.surrogate import FleetLibrary
from ema_identification.actuator.fleet.units import DAYS
from ema_identification.actuator.laws.catalogue import Signature
from ema_identification.actuator.laws.signatures import stacked
from ema_identification.actuator.laws.terms import EffectTerm
from ema_identification.actuator.measure.runs import Progress, silent


@dataclass(frozen=True, kw_only=True)
class JointUnit(TestedUnit):
    """Records of one unit, their features one after another.

    `z` is that of the first record, then what belongs to the day of each further one of `each`.
    """

    each: tuple[TestedUnit, ...]

    @property
    def parts(self) -> tuple[TestedUnit, ...]:
        """Return the single records."""
        return self.each

    @property
    def day(self) -> np.ndarray:
        """Return which numbers belong to the day of a test, shape (width,), bool."""
        return np.append(self.library.of_day, np.ones((len(self.each) - 1) * DAYS, dtype=bool))

    @cached_property
    def places(self) -> list[np.ndarray]:
        """Return where the numbers of each record stand in `z`."""
        found, width = [], self.library.width
        for k in range(len(self.each)):
            places = np.arange(width)
            if k:
                places[self.library.of_day] = width + (k - 1) * DAYS + np.arange(DAYS)
            found.append(places)
        return found

    def noise(self) -> np.ndarray:
        """Return the covariance of the features of a run of all tests."""
        return np.asarray(block_diag(*(part.noise() for part in self.each)))

    def covariance(self, runs: int) -> np.ndarray:
        """Return the covariance of what the right model leaves of all records."""
        return np.asarray(block_diag(*(part.covariance(runs) for part in self.each)))

    def run_all(
        self, models: Sequence[tuple[Sequence[EffectTerm], np.ndarray]], runs: int, salt: int = 0,
        *, apart: bool = False,
    ) -> list[np.ndarray]:
        """Return the mean features of runs of each model on all tests."""
        rows = [part.run_all([(terms, z[places]) for terms, z in models], runs, salt, apart=apart)
                for part, places in zip(self.each, self.places)]
        return [np.concatenate(row) for row in zip(*rows)]

    def means(self, z: np.ndarray) -> np.ndarray:
        """Return what the quadratics predict for units, shape (n, width) -> (n, d)."""
        return np.hstack([part.means(z[:, places])
                          for part, places in zip(self.each, self.places)])

    def slope(self, z: np.ndarray) -> np.ndarray:
        """Return the derivative of `means`, shape (d, width)."""
        found = np.zeros((self.size, len(z)))
        begin = 0
        for part, places in zip(self.each, self.places):
            found[begin:begin + part.size, places] = part.slope(z[places])
            begin += part.size
        return found

    def set_aside(self) -> list[TestedUnit | None]:
        """Return healthy units, each in all tests: they are the same ones in every test."""
        return [_together([unit for unit in units if unit], self.library) if all(units) else None
                for units in zip(*(part.set_aside() for part in self.each))]


def _together(units: Sequence[TestedUnit], library: FleetLibrary) -> JointUnit:
    width = library.width + (len(units) - 1) * DAYS
    first = units[0]
    return JointUnit(
        library=library, each=tuple(units), values=np.concatenate([u.values for u in units]),
        conditions=first.conditions, seed=first.seed, workers=first.workers,
        simulator=first.simulator, centre=np.zeros(width), weight=np.full(width, PRIOR),
        record=first.record)


def joint_unit(
    units: Sequence[TestedUnit],
    scored: Callable[[TestedUnit], tuple[float, ...]] | None = None,
    folder: Path | None = None, *, progress: Progress = silent,
) -> TestedUnit:
    """Return records of one unit as one; a single one as it is.

    `scored` : gives the scores of healthy units, which are ranked on all tests together; a record
    that only judges needs none. `folder` : where new ones are kept, default the cache.
    """
    if len(units) == 1:
        return units[0]
    libraries = [u.library for u in units]
    by_name: dict[str, list[Signature]] = {}
    for library in libraries:
        for signature in library.signatures:
            by_name.setdefault(signature.variant.name, []).append(signature)
    features = tuple(f for library in libraries for f in library.fmap.features)
    library = replace(
        libraries[0], fmap=replace(libraries[0].fmap, features=features),
        signatures=tuple(stacked(s) for s in by_name.values() if len(s) == len(units)))
    unit = _together(units, library)
    if scored is None:
        return unit
    healthy = kept_of(  # of a copy each: what a unit works out of all features goes with it
        libraries, "joint", [u for u in unit.set_aside() if u is not None],
        lambda one: scored(replace(one)), folder, progress=progress)
    return replace(unit, library=replace(library, healthy=healthy))
