"""What healthy machines leave over their best model, feature by feature: the discrepancy.

Its mean over units is measured with an error, the spread between units over the root of their
number; what is not larger than that error is no discrepancy. So each mean is shrunk by
1 − error² / mean², not below 0 (the positive part of James and Stein 1961), and its error is
added to the spread of the fleet, one draw a unit: it is the same in all records of a unit. Where
units differ more than the fleet, so is the rest of their variance; of few units it is known but
badly, and a hundred features together tell how badly (`moderated`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ema_prognostics.cascade.model_body import DiscrepancyPart, LimitPart, ViewPart, rounded
from ema_prognostics.training.fleet import FleetFeatures

LEAST_RATIO, LEAST_FEATURES, MOST_FREEDOM = 1e-6, 10, 1e4
"""Variance ratio of a feature that differs at all; fewest of these that tell a prior; its degrees
of freedom from which all variances are as good as equal."""
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
    off = rows - model
    means = np.array([off[units == unit].mean(axis=0) for unit in np.unique(units)])
    n = len(means)
    left = means.mean(axis=0)
    own = spread * np.sqrt(moderated((means.std(axis=0, ddof=1) / spread)**2, n - 1))
    error = np.maximum(own, spread) / np.sqrt(n)
    share = np.clip(1.0 - error**2 / np.maximum(left**2, 1e-30), 0.0, 1.0)
    still = np.array([n.startswith(NOT_SHIFTED) for n in names])
    share[still] = 0.0
    # Units that differ more than the trained fleet: the rest of their variance is added too.
    more = np.maximum(own**2 - spread**2, 0.0)
    wide = np.sqrt(share * error**2 + more)
    wide[still] = 0.0
    return DiscrepancyPart(names=list(names), mean=rounded(share * left), spread=rounded(wide))


def moderated(ratio: np.ndarray, freedom: int) -> np.ndarray:
    """Return variance ratios of many features, each of few degrees of freedom, drawn together.

    Empirical Bayes with a scaled inverse chi-square prior, whose scale and degrees of freedom
    fit the logarithms of all (Smyth 2004, section 6.2).

    Parameters
    ----------
    ratio : ndarray, shape (d,). Measured, not negative.
    freedom : of each.
    """
    from scipy.optimize import brentq
    from scipy.special import digamma, polygamma

    known = ratio > LEAST_RATIO
    if np.count_nonzero(known) < LEAST_FEATURES:
        return ratio
    half = 0.5 * freedom
    logs = np.log(ratio[known]) - digamma(half) + np.log(half)
    beyond = float(logs.var(ddof=1) - polygamma(1, half))
    if beyond <= float(polygamma(1, 0.5 * MOST_FREEDOM)):
        prior = MOST_FREEDOM
    else:
        prior = 2.0 * brentq(lambda v: float(polygamma(1, v)) - beyond, 1e-3, 0.5 * MOST_FREEDOM)
    scale = np.exp(logs.mean() + digamma(0.5 * prior) - np.log(0.5 * prior))
    return np.asarray((prior * scale + freedom * ratio) / (prior + freedom))


def expected(fleet: FleetFeatures, names: list[str], rows: np.ndarray) -> np.ndarray:
    """Return the mean features of a fleet's healthy tests in the conditions of others, (n, d).

    Parameters
    ----------
    fleet : healthy.
    names : of the features, (d,).
    rows : ndarray, shape (n, d). Features of the others.
    """
    own = np.vstack([fleet.baseline, fleet.record])[:, [fleet.names.index(n) for n in names]]
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
    return replace(fleet, baseline=fleet.baseline + added, record=fleet.record + added)


def widened(view: ViewPart, factor: float) -> ViewPart:
    """Return a view whose guard turns away only what is `factor` times as far off."""
    assert view.guard is not None

    def wide(part: LimitPart) -> LimitPart:
        return part.model_copy(update={
            "limit": rounded(factor * np.array(part.limit)), "distance": factor * part.distance,
            "tail": part.tail,
            "groups": {name: g.model_copy(update={"distance": factor * g.distance})
                       for name, g in part.groups.items()},
        })

    limits = {name: wide(part) for name, part in view.guard.limits.items()}
    return view.model_copy(update={"guard": view.guard.model_copy(update={"limits": limits})})
