"""Gap on a held-out record: what a fitted model leaves of a test that took no part in the fit.

What belongs to the day (load, errors of the current sensors) is fitted to the held-out record, and
runs are made on that day, since a law may act on what the day brings; all else is predicted, of
what is named by the fit or by the median of runs about it, over all that the fitted records leave
open (a few may run away), whichever is nearer. One yardstick for all models: what the model
without a law may be off, and what runs of the named one are where these do not explain each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cholesky
from scipy.optimize import Bounds, minimize

from ema_identification.actuator.decision.fit import PRIOR, TestedUnit
from ema_identification.actuator.decision.intervals import at
from ema_identification.actuator.decision.models import noisy
from ema_identification.actuator.decision.slopes import bounded_least_squares
from ema_identification.actuator.fleet.kept import kept_of
from ema_identification.actuator.fleet.surrogate import SETTLED_RUNS, worst
from ema_identification.actuator.laws.catalogue import OF_THE_ROTOR
from ema_identification.actuator.laws.terms import SURE, LawFit, LawGap, Posterior, coordinates
from ema_identification.actuator.measure.runs import Progress, silent
from ema_identification.actuator.measure.tolerances import TOLERANCES
from ema_sim.machine import TURN

DAY_STEPS = 2
"""Of a fit of what belongs to the day, in which the quadratic is nearly straight."""
DRAWS, DAYS, TWISTS = 3 * SETTLED_RUNS, 40, np.linspace(-1.0, 1.0, 5)
"""Budget: runs over what the fitted records leave open; days that are tried, first twists."""
LOAD = [t.name for t in TOLERANCES].index("surface_load.constant")
LETS_GO = [LOAD, -2, -1]
"""Numbers of a day that friction answers: load, and how surface and shaft stand at the start."""


class _Predicted(NamedTuple):
    """What is expected of a held-out record."""

    unit: TestedUnit
    """The record."""
    z: np.ndarray
    """Numbers of the unit and of the day, as far as it is known before the last step."""
    mean: np.ndarray
    """Features there."""
    reach: np.ndarray
    """Half widths of its band that each number may be off on that day."""


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Held-out records of the unit of `fitted`, as one."""

    unit: TestedUnit
    fitted: TestedUnit
    progress: Progress = silent

    def gap(self, models: Sequence[LawFit], edge: float = 1.0, known: Posterior | None = None
            ) -> LawGap:
        """Return the gap of each model, the first without a law.

        A fit on the quadratic is predicted as healthy units are, by the quadratic; fits on runs
        are by means of runs. `edge` : half widths of its band that a number may be off. `known` :
        what the fitted records tell of the last model.
        """
        unit, null = self.unit, models[0]
        if not null.runs and len(models) == 1:
            return replace(quadratic_gap(unit, self.fitted, null, edge), healthy=self.healthy)
        bound = float(np.quantile(self.healthy, SURE))
        turned = [[_best_day(_nearest_turn(part, m, edge), m, bound) for part in unit.parts]
                  for m in models]
        if known is not None:
            turned[-1] = [min(one, _expected(one, models[-1], known, edge), key=_off)
                          for one in turned[-1]]
        expected = [_joined(unit, of) for of in turned]
        if known is not None:
            unit = noisy(unit, replace(models[-1], z=expected[-1].z))
        return replace(_left(unit, _yardstick(self.fitted), expected), healthy=self.healthy)

    @cached_property
    def healthy(self) -> np.ndarray:
        """Return the gaps of the units set aside, each in all tests, shape (n,)."""
        return self.kept(None)

    def kept(self, folder: Path | None) -> np.ndarray:
        """Return `healthy`; what is not kept yet is put into `folder`, default the cache."""
        pairs = [(held, fitted) for held, fitted in zip(
            self.unit.set_aside(), self.fitted.set_aside())
            if held is not None and fitted is not None]
        libraries = [part.library for unit in (self.unit, self.fitted) for part in unit.parts]
        return kept_of(libraries, f"gaps{len(self.unit.parts)}", pairs, _healthy_gap, folder,
                       progress=self.progress)[:, 0]


def _healthy_gap(pair: tuple[TestedUnit, TestedUnit]) -> tuple[float, ...]:
    held, fitted = pair[0], replace(pair[1])  # what it works out goes with it
    return quadratic_gap(held, fitted, fitted.without_law()).values


def quadratic_gap(
    unit: TestedUnit, fitted: TestedUnit, null: LawFit, edge: float = 1.0
) -> LawGap:
    """Return the gap of a unit without a law on `unit`, its quadratic at the fit to `fitted`."""
    z = _of_the_unit(unit, null, edge)
    return _left(unit, _yardstick(fitted, null), [
        _Predicted(unit, z, unit.means(z[None])[0], _reach(unit, null))])


def fitted_gap(unit: TestedUnit, models: Sequence[LawFit]) -> LawGap:
    """Return the gap on the fitted records themselves, where no other one is given."""
    root = np.sqrt(np.diag(unit.covariance(0)))
    rests = [(unit.values - m.mean) / root for m in models]
    return LawGap(values=tuple(worst(rests)), healthy=unit.library.healthy[:, 2],
                  rest=tuple(rests))


def _of_the_unit(unit: TestedUnit, fit: LawFit, edge: float, day: ArrayLike = 0.0) -> np.ndarray:
    """Return what a fit expects of held-out records: the unit's own numbers, on a `day`."""
    z = np.zeros(len(unit.centre))
    own = slice(unit.library.width)
    z[own] = np.clip(fit.z[own], -edge, edge)
    z[unit.day] = day
    return z


def _reach(unit: TestedUnit, fit: LawFit) -> np.ndarray:
    """Return how far each number may be off on the day of a held-out record, in half widths.

    A law that adds to a number of the day is fitted as the sum of both: the difference of two
    days has twice the band of one.
    """
    laws = {f"{t.variant.effect}.{name}" for t in fit.terms for name in t.variant.settings(t.u)}
    found = np.ones(len(unit.centre))
    found[[place for place, t in enumerate(TOLERANCES) if t.name in laws]] = 2.0
    return found


def _joined(unit: TestedUnit, parts: Sequence[_Predicted]) -> _Predicted:
    """Return what is expected of held-out records as one."""
    z, reach = np.zeros(len(unit.centre)), np.ones(len(unit.centre))
    for part, places in zip(parts, unit.places):
        z[places], reach[places] = part.z, part.reach
    return _Predicted(unit, z, np.concatenate([part.mean for part in parts]), reach)


def _expected(predicted: _Predicted, fit: LawFit, known: Posterior, edge: float) -> _Predicted:
    """Return a prediction anew, the median of runs about a fit over what its records leave open.

    As it is where most of these cannot be run.
    """
    unit, day = predicted.unit, predicted.z[predicted.unit.day]
    half = np.random.default_rng([unit.seed, 91]).standard_normal((DRAWS // 2, len(known.mean)))
    points = np.append(coordinates(fit.terms), fit.z) + np.vstack([half, -half]) @ cholesky(
        known.covariance)
    rows = np.array(unit.run_all(
        [(model.terms, _of_the_unit(unit, model, edge, day))
         for model in (at(fit, x) for x in points)], 1, salt=23, apart=True))
    good = rows[np.isfinite(rows).all(axis=1)]
    return predicted if 2 * len(good) < len(rows) else predicted._replace(
        mean=np.median(good, axis=0))


def _nearest_turn(unit: TestedUnit, fit: LawFit, edge: float) -> _Predicted:
    """Return what runs of a fit on one held-out record are in the mean, which knows the turn.

    On the day that the record tells from runs on a middling one. The rotor starts in any of the
    electrical turns that make a mechanical one, and no record says in which; of laws that know
    the mechanical angle the nearest one counts.
    """
    z, laws = _of_the_unit(unit, fit, edge), {t.variant.effect for t in fit.terms}
    turns = unit.library.model.actuator.motor.pole_pairs if laws & OF_THE_ROTOR else 1
    angle = unit.conditions.start_angle
    units = [replace(unit, conditions=replace(unit.conditions, start_angle=angle + k * TURN))
             for k in range(turns)]
    reach = _reach(unit, fit)
    found = [_Predicted(one, z, one.run(fit.terms, z, SETTLED_RUNS, salt=21), reach)
             for one in units]
    best = min(found, key=_off)
    there = _day_fitted(best.unit, best, _root(unit))[0]
    mean = best.unit.run(fit.terms, there, SETTLED_RUNS, salt=21)
    return _Predicted(best.unit, there, mean, reach) if np.isfinite(mean).all() else best


def _best_day(found: _Predicted, fit: LawFit, bound: float) -> _Predicted:
    """Return a prediction on the day that leaves least, where its own leaves much.

    Slopes do not lead there where something lets go: from some load on the surface turns the
    motor, from some twist on it slips as the test begins. From the best of a few twists a simplex
    looks for it (Nelder and Mead 1965). Nothing has the same chance as a law, or that would have
    the credit of the day.
    """
    unit = found.unit
    if worst([_day_fitted(unit, found, _root(unit))[1]])[0] <= bound:
        return found

    def on(day: np.ndarray) -> _Predicted:
        z = found.z.copy()
        z[LETS_GO] = day
        return _Predicted(unit, z, unit.run(fit.terms, z, SETTLED_RUNS, salt=21), found.reach)

    def off(day: np.ndarray) -> float:
        return _off(on(day))

    own, reach = found.z[LETS_GO], found.reach[LETS_GO]
    begin = min([own, *(np.append(own[:-1], twist) for twist in TWISTS)], key=off)
    inwards = begin - np.diff(TWISTS)[0] / 2.0 * np.diag(np.where(begin > 0.0, reach, -reach))
    best = minimize(
        off, begin, method="Nelder-Mead", bounds=Bounds(-reach, reach),
        options={"maxfev": DAYS, "initial_simplex": np.vstack([begin, inwards])}).x
    return min(found, on(best), key=_off)


def _off(predicted: _Predicted) -> float:
    """Return by how much a prediction is off, what is far off by its logarithm."""
    rest = _day_fitted(predicted.unit, predicted, _root(predicted.unit))[1]
    return float(np.log1p(rest**2).sum())


def _root(unit: TestedUnit) -> np.ndarray:
    return np.sqrt(np.diag(unit.covariance(SETTLED_RUNS)))


def _yardstick(fitted: TestedUnit, null: LawFit | None = None) -> np.ndarray:
    """Return the covariance of the fitted unit, shape (width, width); of the day: none."""
    null = null or fitted.without_law()
    columns = fitted.whitener(0).columns(null.slopes, fitted.values - null.mean)
    own, day = slice(fitted.library.width), fitted.library.of_day
    found = np.linalg.inv(columns.T @ columns + PRIOR * np.eye(columns.shape[1]))[own, own]
    found[day] = found[:, day] = 0.0
    return np.asarray(found)


def _left(unit: TestedUnit, covariance: np.ndarray, models: Sequence[_Predicted]) -> LawGap:
    """Return the gap of each prediction, on the scale of the first one."""
    own = unit.slope(models[0].z)[:, :len(covariance)]
    root = np.sqrt(np.diag(unit.covariance(0)) + unit.scatter
                   + np.einsum("ij,jk,ik->i", own, covariance, own))
    rests = [_day_fitted(unit, model, root)[1] for model in models]
    return LawGap(values=tuple(worst(rests)), healthy=np.zeros(0), rest=tuple(rests))


def _day_fitted(unit: TestedUnit, model: _Predicted, root: np.ndarray
                ) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers once those of the day are fitted to a record, and what is left of it.

    Within their bands, by what the quadratic says that the day adds; left in deviations `root`,
    infinite of a model that the simulator cannot run.
    """
    there, rest, reach = model.z, unit.values - model.mean, model.reach[unit.day]
    if not np.isfinite(rest).all():
        return there, np.full_like(rest, np.inf)
    for _ in range(DAY_STEPS):
        given = there[unit.day]
        step = bounded_least_squares(
            unit.slope(there)[:, unit.day] / root[:, None], rest / root, -reach - given,
            reach - given, np.full(len(given), PRIOR), given)
        there = there.copy()
        there[unit.day] += step
        rest = unit.values - model.mean - np.diff(
            unit.means(np.array([model.z, there])), axis=0)[0]
    return there, np.asarray(rest / root)
