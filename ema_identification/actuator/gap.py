"""Gap on a held-out record: what a fitted model leaves of a test that took no part in the fit.

What belongs to the day (load, errors of the current sensors) is fitted to the held-out record;
all else is predicted, of what is named by the median of runs about the fit, over all that the
fitted records leave open: a few may run away. One yardstick for all models: what the model without
a law may be off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.linalg import cholesky

from ema_identification.actuator.decision.fit import PRIOR, TestedUnit
from ema_identification.actuator.decision.intervals import at
from ema_identification.actuator.decision.slopes import bounded_least_squares
from ema_identification.actuator.fleet.kept import kept_of
from ema_identification.actuator.fleet.surrogate import SETTLED_RUNS, worst
from ema_identification.actuator.laws.catalogue import OF_THE_ROTOR
from ema_identification.actuator.laws.terms import LawFit, LawGap, Posterior, coordinates
from ema_identification.actuator.measure.signals import TURN

DAY_STEPS = 2
"""Of a fit of what belongs to the day, in which the quadratic is nearly straight."""
DRAWS = 3 * SETTLED_RUNS
"""Budget: runs over what the fitted records leave open."""

_Predicted = tuple[TestedUnit, np.ndarray]
"""A held-out record and what is expected of it."""


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Held-out records of the unit of `fitted`, as one."""

    unit: TestedUnit
    fitted: TestedUnit

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
        turned = [[_nearest_turn(part, m, edge) for part in unit.parts] for m in models]
        if known is not None:
            turned[-1] = [_expected(one, models[-1], known, edge) for one in turned[-1]]
        means = [np.concatenate([mean for _, mean in of]) for of in turned]
        return replace(_left(unit, _yardstick(self.fitted), _of_the_unit(unit, null, edge), means),
                       healthy=self.healthy)

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
        return kept_of(libraries, f"gaps{len(self.unit.parts)}", pairs, _healthy_gap,
                       folder)[:, 0]


def _healthy_gap(pair: tuple[TestedUnit, TestedUnit]) -> tuple[float, ...]:
    held, fitted = pair
    return quadratic_gap(held, fitted, fitted.without_law()).values


def quadratic_gap(
    unit: TestedUnit, fitted: TestedUnit, null: LawFit, edge: float = 1.0
) -> LawGap:
    """Return the gap of a unit without a law on `unit`, its quadratic at the fit to `fitted`."""
    z = _of_the_unit(unit, null, edge)
    return _left(unit, _yardstick(fitted, null), z, list(unit.means(z[None])))


def fitted_gap(unit: TestedUnit, models: Sequence[LawFit]) -> LawGap:
    """Return the gap on the fitted records themselves, where no other one is given."""
    root = np.sqrt(np.diag(unit.covariance(0)))
    rests = [(unit.values - m.mean) / root for m in models]
    return LawGap(values=tuple(worst(rests)), healthy=unit.library.healthy[:, 2],
                  rest=tuple(rests))


def _of_the_unit(unit: TestedUnit, fit: LawFit, edge: float) -> np.ndarray:
    """Return what a fit expects of held-out records: the unit's own numbers, none of the day."""
    z = np.zeros(len(unit.centre))
    own = slice(unit.library.width)
    z[own] = np.clip(fit.z[own], -edge, edge)
    return np.where(unit.day, 0.0, z)


def _expected(predicted: _Predicted, fit: LawFit, known: Posterior, edge: float) -> _Predicted:
    """Return a prediction anew, the median of runs about a fit over what its records leave open.

    As it is where most of these cannot be run.
    """
    unit, mean = predicted
    half = np.random.default_rng([unit.seed, 91]).standard_normal((DRAWS // 2, len(known.mean)))
    points = np.append(coordinates(fit.terms), fit.z) + np.vstack([half, -half]) @ cholesky(
        known.covariance)
    rows = np.array(unit.run_all(
        [(model.terms, _of_the_unit(unit, model, edge))
         for model in (at(fit, x) for x in points)], 1, salt=23, apart=True))
    good = rows[np.isfinite(rows).all(axis=1)]
    return unit, mean if 2 * len(good) < len(rows) else np.median(good, axis=0)


def _nearest_turn(unit: TestedUnit, fit: LawFit, edge: float) -> _Predicted:
    """Return the mean of runs of a fit on one held-out record, which knows the turn.

    The rotor starts in any of the electrical turns that make a mechanical one, and no record says
    in which; of laws that know the mechanical angle the nearest one counts.
    """
    z, laws = _of_the_unit(unit, fit, edge), {t.variant.effect for t in fit.terms}
    turns = unit.library.model.actuator.motor.pole_pairs if laws & OF_THE_ROTOR else 1
    angle, root = unit.conditions.start_angle, np.sqrt(np.diag(unit.covariance(SETTLED_RUNS)))
    units = [replace(unit, conditions=replace(unit.conditions, start_angle=angle + k * TURN))
             for k in range(turns)]
    return min(((one, one.run(fit.terms, z, SETTLED_RUNS, salt=21)) for one in units),
               key=lambda found: float(np.log1p(_less_day(unit, z, found[1], root) ** 2).sum()))


def _yardstick(fitted: TestedUnit, null: LawFit | None = None) -> np.ndarray:
    """Return the covariance of the fitted unit, shape (width, width); of the day: none."""
    null = fitted.without_law() if null is None or null.runs else null
    columns = fitted.whitener(0).columns(null.slopes, fitted.values - null.mean)
    own, day = slice(fitted.library.width), fitted.library.of_day
    found = np.linalg.inv(columns.T @ columns + PRIOR * np.eye(columns.shape[1]))[own, own]
    found[day] = found[:, day] = 0.0
    return np.asarray(found)


def _left(unit: TestedUnit, covariance: np.ndarray, z: np.ndarray, means: Sequence[np.ndarray]
          ) -> LawGap:
    """Return the gap of each prediction, on the scale of the first at `z`."""
    own = unit.slope(z)[:, :len(covariance)]
    root = np.sqrt(np.diag(unit.covariance(0)) + np.einsum("ij,jk,ik->i", own, covariance, own))
    rests = [_less_day(unit, z, mean, root) for mean in means]
    return LawGap(values=tuple(worst(rests)), healthy=np.zeros(0), rest=tuple(rests))


def _less_day(unit: TestedUnit, z: np.ndarray, mean: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Return what is left of a record, in deviations, once what belongs to the day is fitted.

    Within its bands, by what the quadratic says that it adds to `mean` at `z`; infinite of a
    model that the simulator cannot run.
    """
    if not np.isfinite(mean).all():
        return np.full_like(mean, np.inf)
    there, rest = z, unit.values - mean
    for _ in range(DAY_STEPS):
        given = there[unit.day]
        step = bounded_least_squares(
            unit.slope(there)[:, unit.day] / root[:, None], rest / root, -1.0 - given,
            1.0 - given, np.full(len(given), PRIOR), given)
        there = there.copy()
        there[unit.day] += step
        rest = unit.values - mean - np.diff(unit.means(np.array([z, there])), axis=0)[0]
    return np.asarray(rest / root)
