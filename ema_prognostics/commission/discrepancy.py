"""What healthy machines leave over their best model, feature by feature: the discrepancy.

`ema_record.spread` says how it is estimated; its spread is added to that of the fleet, one
draw a unit: it is the same in all records of a unit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ema_prognostics.cascade.lines import hidden_lines
from ema_prognostics.cascade.model_body import DiscrepancyPart, LimitPart, ViewPart, rounded
from ema_prognostics.features.vector import steady
from ema_prognostics.training.fleet import FleetFeatures
from ema_record.spread import left_over

CONDITIONS = ("temperature", "bus_voltage", "load_")
"""Beginnings of features that are conditions of a test."""
NOT_SHIFTED = (*CONDITIONS, "gap_load", "start_position", "offset_largest", "gain_largest",
               "sum_mean")
"""Beginnings of features that are conditions of the test or errors of the sensors: those of the
acceptance records say nothing about those of the next test."""


def fit_discrepancy(
    names: list[str], rows: np.ndarray, units: np.ndarray, model: np.ndarray, spread: np.ndarray
) -> DiscrepancyPart:
    """Return the discrepancy of acceptance records.

    Parameters
    ----------
    names : of the features, (d,).
    rows : ndarray, shape (n, d). Features of the records.
    units : ndarray, shape (n,). Unit of each.
    model : ndarray, shape (n, d). What the corrected model gives in their conditions.
    spread : ndarray, shape (d,). Standard deviation of the features over healthy tests of the
        type as it is trained.
    """
    left, wide = left_over(rows - model, units, spread)
    still = np.array([n.startswith(NOT_SHIFTED) for n in names])
    return DiscrepancyPart(names=list(names), mean=rounded(np.where(still, 0.0, left)),
                           spread=rounded(np.where(still, 0.0, wide)))


def expected(fleet: FleetFeatures, names: list[str], rows: np.ndarray) -> np.ndarray:
    """Return the mean features of a fleet's healthy tests in the conditions of others, (n, d).

    Parameters
    ----------
    fleet : healthy.
    names : of the features, (d,).
    rows : ndarray, shape (n, d). Features of the others.
    """
    own = fleet.both(names)
    own = steady(names, own, np.median(own, axis=0))
    given = [k for k, n in enumerate(names) if n.startswith(CONDITIONS)]
    center = own[:, given].mean(axis=0)
    design = np.column_stack([np.ones(len(own)), own[:, given] - center])
    slopes, *_ = np.linalg.lstsq(design, own, rcond=None)
    return np.asarray(
        np.column_stack([np.ones(len(rows)), rows[:, given] - center]) @ slopes)


def with_discrepancy(
    fleet: FleetFeatures, discrepancy: DiscrepancyPart, seed: int
) -> FleetFeatures:
    """Return a fleet whose units differ by the spread of the discrepancy too."""
    place = {name: k for k, name in enumerate(discrepancy.names)}
    spread = np.array([discrepancy.spread[place[n]] if n in place else 0.0 for n in fleet.names])
    numbers, inverse = np.unique(fleet.unit, return_inverse=True)
    rng = np.random.default_rng([seed, 7])
    added = (rng.standard_normal((len(numbers), len(spread))) * spread)[inverse]
    baseline, record = (x + np.where(hidden_lines(fleet.names, x), 0.0, added)
                        for x in (fleet.baseline, fleet.record))
    return replace(fleet, baseline=baseline, record=record)


def widened(view: ViewPart, factor: float, strangers: float) -> ViewPart:
    """Return a view that turns away only what is further off.

    Parameters
    ----------
    factor : by which the guard's limits grow.
    strangers : the same of the filters for strangers.
    """

    def wide(part: LimitPart) -> LimitPart:
        return part.model_copy(update={
            "limit": rounded(factor * np.array(part.limit)), "distance": factor * part.distance,
            "groups": {name: g.model_copy(update={"distance": factor * g.distance})
                       for name, g in part.groups.items()},
        })

    limits = {name: wide(part) for name, part in view.guard.limits.items()}
    filters = None if view.strangers is None else view.strangers.model_copy(update={"filters": {
        kind: one.model_copy(update={"limits": rounded(strangers * np.array(one.limits))})
        for kind, one in view.strangers.filters.items()}})
    return view.model_copy(update={
        "guard": view.guard.model_copy(update={"limits": limits}), "strangers": filters})
