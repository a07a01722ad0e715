"""What has changed since a unit was accepted: its record against its own earlier ones.

What the model leaves of the accepted records is taken off the later one, y - (y0 - f(z, c0)), so
that what a number of the unit does to both records cancels: it matters as far as it acts otherwise
on another day. What belongs to the day is free. The error of such a difference is that of repeats
of both records and the part of the quadratic's error that two tests of one unit do not share,
which healthy units, tested on two days, tell; they also give the ranks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from ema_identification.actuator.decision.fit import PRIOR, TestedUnit, units_aside
from ema_identification.actuator.decision.proposals import Scores, scores
from ema_identification.actuator.fleet.kept import AGAIN, ALIKE, kept_arrays
from ema_identification.actuator.fleet.surrogate import SETTLED_RUNS, FleetLibrary
from ema_identification.actuator.fleet.units import (
    CHUNK,
    FULL,
    draw_fleet_conditions,
    draw_fleet_unit,
    fleet_record,
    of_day,
)
from ema_identification.actuator.laws.terms import EffectTerm
from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.runs import Progress, silent, spread_out
from ema_identification.actuator.measure.tolerances import CONDITIONS, align, conditions_of
from ema_record import array_cache as cache
from ema_record.errors import InvalidRecordError, SimulationError
from ema_record.spread import TypeSpread
from ema_sim.model_file import Model


@dataclass(frozen=True, kw_only=True)
class ChangedUnit(TestedUnit):
    """A record of a unit of which accepted ones are known, less what the model leaves of these.

    Attributes
    ----------
    accepted : the accepted records, at least one.
    at : their fits, shape (width,) each.
    before : ndarray, shape (d,). What the quadratic says of them there, the mean.
    apart : share of the quadratic's error that two tests of one unit do not share.
    """

    accepted: tuple[TestedUnit, ...]
    at: tuple[np.ndarray, ...]
    before: np.ndarray
    apart: float = 0.0

    def covariance(self, runs: int) -> np.ndarray:
        """Return the covariance of what is off: of both records, see the module."""
        law, k = self.library.repeat, len(self.accepted)
        found = law.covariance(self.conditions.noise)
        for unit in self.accepted:
            found = found + law.covariance(unit.conditions.noise) / k**2
        share = min(self.apart, self.library.carried) if runs else self.apart
        surrogate = self.library.surrogate.covariance(self.conditions.noise)
        return np.asarray((1.0 + (1.0 / runs if runs else 0.0)) * found + share**2 * surrogate)

    @cached_property
    def _shift(self) -> np.ndarray:
        """Return how far runs of the accepted unit are from its quadratic, shape (d,)."""
        runs = [u.run((), z, SETTLED_RUNS, salt=51) for u, z in zip(self.accepted, self.at)]
        return np.asarray(self.before - np.mean(runs, axis=0))

    def _ahead(self, z: np.ndarray) -> np.ndarray:
        """Return how far the accepted records of other units are, shape (n, width) -> (n, d)."""
        found = [u.library.means(np.where(self.library.of_day, at, z), u.conditions)
                 for u, at in zip(self.accepted, self.at)]
        return np.asarray(np.mean(found, axis=0) - self.before)

    def means(self, z: np.ndarray) -> np.ndarray:
        """Return what the quadratic predicts for units that left the accepted records."""
        return super().means(z) - self._ahead(z)

    def slope(self, z: np.ndarray) -> np.ndarray:
        """Return the derivative of `means`, shape (d, width)."""
        before = np.mean([u.library.slope(np.where(self.library.of_day, at, z), u.conditions)
                          for u, at in zip(self.accepted, self.at)], axis=0)
        return super().slope(z) - np.where(self.library.of_day, 0.0, before)

    def run_all(
        self, models: Sequence[tuple[Sequence[EffectTerm], np.ndarray]], runs: int, salt: int = 0,
        *, apart: bool = False,
    ) -> list[np.ndarray]:
        """Return the mean features of runs, less what runs of the accepted unit are off."""
        found = super().run_all(models, runs, salt, apart=apart)
        return [mean + self._shift - self._ahead(np.clip(z, -self.edge, self.edge)[None])[0]
                for mean, (_, z) in zip(found, models)]


def changed_unit(
    unit: TestedUnit, accepted: Sequence[TestedUnit], apart: float
) -> ChangedUnit:
    """Return a record, of the library of `with_baselines`, beside accepted ones of test and unit.

    What a type leaves of the model is in both records; it belongs to the fit of the accepted ones.
    The unit's own numbers are the mean of those that the accepted records give. What belongs to
    the day of these is known no better than they tell: from there the later one may be as far
    again (gains common to all current sensors, which no single test tells from the motor's).
    """
    fits = [u.without_law() for u in accepted]
    own, day = np.mean([f.z for f in fits], axis=0), unit.library.of_day
    found, k = np.empty((len(fits), len(own), len(own))), len(fits)
    for covariance, u, fit in zip(found, accepted, fits):
        columns = u.whitener(0).columns(fit.slopes, u.values - fit.mean)
        covariance[:] = np.linalg.inv(columns.T @ columns + PRIOR * np.eye(len(own)))
    untold = found[:, :, ~day]  # of the same numbers in all fits: no mean makes that less
    unsure = np.diagonal(found.sum(axis=0)) / k**2 + PRIOR * (
        (untold.mean(axis=0) ** 2).sum(axis=1) - (untold**2).sum(axis=(0, 2)) / k**2)
    at = tuple(np.where(day, f.z, own) for f in fits)
    accepted = [replace(u, library=replace(u.library, left=None)) for u in accepted]
    before = np.mean([u.library.means(z[None], u.conditions)[0]
                      for u, z in zip(accepted, at)], axis=0)
    return ChangedUnit(
        library=unit.library, conditions=unit.conditions, seed=unit.seed,
        values=unit.values - np.mean([u.values for u in accepted], axis=0) + before,
        workers=unit.workers, simulator=unit.simulator, record=unit.record,
        accepted=tuple(accepted), at=at,
        before=before, apart=apart, centre=np.where(day, 0.0, own),
        weight=1.0 / (unsure + np.where(day, 1.0 / PRIOR, 0.0)),
        edge=np.where(day, 2.0, 1.0))


def _days(model: Model, spread: TypeSpread, fmap: FeatureMap, seed: int, first: int, last: int
          ) -> np.ndarray:
    """Return rows of features and conditions of units on another day; NaN where that failed."""
    rows = []
    for k in range(first, last):
        z = draw_fleet_unit(np.random.default_rng([seed, 7, k]), model.actuator)  # as there
        rng = np.random.default_rng([seed, 9, k])
        z = np.where(of_day(len(z)), draw_fleet_unit(rng, model.actuator), z)
        row = np.full(len(fmap.features) + CONDITIONS, np.nan)
        try:
            record = fleet_record(model, spread, fmap, z, draw_fleet_conditions(rng, spread),
                                  int(rng.integers(2**31)))
            row[:] = [*fmap.extract(record), *align(record, model).row()]
        except (SimulationError, InvalidRecordError):  # left out
            pass
        rows.append(row)
    return np.array(rows)


def with_baselines(
    library: FleetLibrary, *, seed: int = 0, workers: int = 1, progress: Progress = silent,
    folder: Path | None = None,
) -> tuple[FleetLibrary, float]:
    """Return a library without discrepancy, scored by healthy units beside their earlier records.

    And the share of `ChangedUnit.apart`, at which every tenth of them leaves a cost of 1 a
    feature on average. `folder` : where they are kept if they are new, default the cache.
    """
    def make() -> dict[str, np.ndarray]:
        first = FULL.total - len(library.aside[0])
        of = (library.model, library.spread, library.fmap.profile, library.fmap.rate,
              tuple(FULL), seed)
        part = f"part_changed_{cache.key_of(*map(repr, of), module=__name__)}"
        rows = np.concatenate(spread_out(
            partial(_days, library.model, library.spread, library.fmap, seed),
            [(k, min(k + CHUNK, FULL.total)) for k in range(first, FULL.total, CHUNK)],
            workers=workers, progress=progress, what="healthy runs of another day", keep=part))
        found = _judged(library, rows, progress, workers)
        cache.forget(part)
        return found

    found = kept_arrays([library], "changed", make, partial(_agrees, library), folder)
    return replace(library, healthy=found["healthy"]), float(found["apart"])


def _pairs(library: FleetLibrary, rows: np.ndarray, part: slice) -> list[ChangedUnit]:
    """Return some of the healthy units on another day beside themselves, without `apart`."""
    return [changed_unit(TestedUnit(library=library, values=row[:-CONDITIONS],
                                    conditions=conditions_of(row[-CONDITIONS:])), [before], 0.0)
            for row, before in zip(rows[part], units_aside(library)[part])
            if before and np.isfinite(row).all()]


def _ranked(library: FleetLibrary, rows: np.ndarray, apart: float, first: int, last: int
            ) -> np.ndarray:
    """Return the scores of some of the units, shape (n, 4)."""
    units = _pairs(library, rows, slice(first, last))
    return np.array([scores(replace(unit, apart=apart)) for unit in units]).reshape(
        -1, len(Scores._fields))


def _judged(
    library: FleetLibrary, rows: np.ndarray, progress: Progress, workers: int = 1
) -> dict[str, np.ndarray]:
    some = _pairs(library, rows, slice(None, None, 10))

    def excess(apart: float) -> float:
        tried = [replace(unit, apart=apart) for unit in some]
        return float(np.mean([u.without_law().cost / u.size for u in tried])) - 1.0

    apart = 0.0 if excess(0.0) <= 0.0 else 2.0 if excess(2.0) > 0.0 else float(
        brentq(excess, 0.0, 2.0, xtol=0.02))
    healthy = spread_out(
        partial(_ranked, library, rows, apart),
        [(k, k + CHUNK) for k in range(0, len(rows), CHUNK)], workers=workers,
        progress=progress, what="healthy units since acceptance")
    return {"healthy": np.concatenate(healthy), "apart": np.array(apart), "days": rows[:AGAIN]}


def _agrees(library: FleetLibrary, kept: Mapping[str, np.ndarray]) -> bool:
    """Return whether the present code ranks the first units as they are kept."""
    if not kept.keys() >= {"healthy", "apart", "days"}:
        return False
    again = _ranked(library, kept["days"], float(kept["apart"]), 0, AGAIN)
    return bool(np.allclose(again, kept["healthy"][:len(again)], rtol=ALIKE))
