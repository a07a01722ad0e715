"""Gap on a held-out record: what a fitted model leaves of a test that took no part in the fit.

What belongs to the day (load, errors of the current sensors) is fitted to the held-out record;
all else is predicted. One yardstick for all models: what the model without a law may be off.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.decision.fit import PRIOR, LawFit, TestedUnit
from ema_identification.actuator.decision.fleet import NAMES, SIZE, conditions_of
from ema_identification.actuator.decision.surrogate import FleetLibrary
from ema_identification.actuator.naming.gap import worst
from ema_record import array_cache as cache

RUNS = 8
"""Of a prediction with a law."""
OF_DAY = np.array([n.startswith(("current_sensor", "surface_load")) for n in NAMES])
"""What differs from test to test."""


class LawGap(NamedTuple):
    """The gap of models on one record.

    Attributes
    ----------
    values : of each model.
    healthy : ndarray, shape (n,). Of healthy units without a law.
    """

    values: tuple[float, ...]
    healthy: np.ndarray

    @property
    def floor(self) -> float:
        """What healthy units leave, the median."""
        return float(np.median(self.healthy))

    @property
    def bound(self) -> float:
        """What 95 % of them stay within."""
        return float(np.quantile(self.healthy, 0.95, method="higher"))


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """A held-out record of the unit of `fitted`.

    `healthy` : gaps of healthy units on the same two tests (`healthy_gaps`).
    """

    unit: TestedUnit
    fitted: TestedUnit
    healthy: np.ndarray

    def gap(self, models: Sequence[LawFit]) -> LawGap:
        """Return the gap of each model, the first without a law.

        Alone it is predicted as those of `healthy` are, by the quadratic; beside others all are
        means of runs.
        """
        if len(models) == 1:
            return LawGap((quadratic_gap(self.unit, self.fitted, models[0]),), self.healthy)
        means = [self.unit.run(m.terms, _without_day(m.z), RUNS, salt=21) for m in models]
        return LawGap(tuple(_left(self.unit, _yardstick(self.fitted), _without_day(models[0].z),
                                  means)), self.healthy)


def quadratic_gap(unit: TestedUnit, fitted: TestedUnit, null: LawFit) -> float:
    """Return the gap of a unit without a law on `unit`, its quadratic at the fit to `fitted`."""
    z = _without_day(null.z)
    return _left(unit, _yardstick(fitted, null), z, [unit.library.mean(z, unit.conditions)])[0]


def healthy_gaps(pairs: Sequence[tuple[TestedUnit, TestedUnit]]) -> np.ndarray:
    """Return the gaps of healthy units: (held-out record, fitted record) of each."""
    return np.array([quadratic_gap(held, fitted, fitted.without_law())
                     for held, fitted in pairs])


def paired_units(
    held: FleetLibrary, fitted: FleetLibrary
) -> list[tuple[TestedUnit, TestedUnit]]:
    """Return the units set aside, each in both tests: they are the same ones in every test."""
    def units(library: FleetLibrary) -> list[TestedUnit]:
        return [TestedUnit(library=library, values=values, conditions=conditions_of(row))
                for row, values in zip(*library.aside)]

    return [(a, b) for a, b in zip(units(held), units(fitted))
            if np.isfinite(a.values).all() and np.isfinite(b.values).all()]


def gaps_of_healthy(held: TestedUnit, fitted: TestedUnit) -> np.ndarray:
    """Return `healthy_gaps` of the units set aside of two tests' libraries, kept in the cache."""
    libraries = held.library, fitted.library
    digest = hashlib.sha256(b"".join(
        np.ascontiguousarray(x).tobytes() for library in libraries
        for x in (library.weights, library.aside[1], library.healthy)))
    name = f"gaps_{cache.key_of(digest.hexdigest(), module=__name__)}"
    found = cache.load(name)
    if found is None:
        found = {"gaps": healthy_gaps(paired_units(*libraries))}
        cache.save(name, found)
    return found["gaps"]


FLOOR_UNITS = 20
"""Healthy units that tell what a fit leaves of its own record."""


def fitted_gap(unit: TestedUnit, models: Sequence[LawFit]) -> LawGap:
    """Return the gap on the fitted record itself, where no other one is given."""
    root = np.sqrt(np.diag(unit.covariance(0)))
    healthy = []
    conditions, features = unit.library.aside
    for row, values in list(zip(conditions, features))[:FLOOR_UNITS]:
        one = TestedUnit(library=unit.library, values=values, conditions=conditions_of(row))
        if np.isfinite(values).all():
            rest = values - one.without_law().mean
            healthy.append(worst([[rest / np.sqrt(np.diag(one.covariance(0)))]])[0])
    return LawGap(tuple(worst([[(unit.values - m.mean) / root] for m in models])),
                  np.array(healthy or [np.nan]))


def _without_day(z: np.ndarray) -> np.ndarray:
    return np.where(OF_DAY, 0.0, np.clip(z, -1.0, 1.0))


def _yardstick(fitted: TestedUnit, null: LawFit | None = None) -> np.ndarray:
    """Return the covariance of the fitted unit, shape (SIZE, SIZE); of the day: none."""
    null = fitted.without_law() if null is None or null.runs else null
    columns = fitted.whitener(0).columns(null.slopes, fitted.values - null.mean)
    found = np.linalg.inv(columns.T @ columns + PRIOR * np.eye(SIZE))
    found[OF_DAY] = found[:, OF_DAY] = 0.0
    return np.asarray(found)


def _left(unit: TestedUnit, covariance: np.ndarray, z: np.ndarray, means: Sequence[np.ndarray]
          ) -> list[float]:
    """Return the gap of each prediction, on the scale of the first at `z`."""
    slope = unit.library.slope(z, unit.conditions)
    root = np.sqrt(np.diag(unit.covariance(0)) + np.einsum(
        "ij,jk,ik->i", slope, covariance, slope))
    day = slope[:, OF_DAY] / root[:, None]
    solve = np.linalg.inv(day.T @ day + PRIOR * np.eye(day.shape[1])) @ day.T
    rests = [(unit.values - mean) / root for mean in means]
    return worst([[rest - day @ np.clip(solve @ rest, -1.0, 1.0)] for rest in rests])
