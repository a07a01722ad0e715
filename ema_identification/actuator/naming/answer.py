"""The answer on a unit, and the sets of names that its data cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.actuator.surrogate.fit import Fit
from ema_identification.result import Outcome

LARGEST_SET = 3
"""More names that the data cannot tell apart are no answer."""
SET_MARGIN = 14.0
"""Costs that differ by less, in units of the cost a feature, do not tell two effects apart."""
SET_SHARE = (0.02, 0.15)
"""The same, of the misfit that was explained and at most of the cost (error of simulation)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What was decided.

    Attributes
    ----------
    verdict : of the identification.
    fit : of the effects that are added; None for none.
    fits : all single candidates that were fitted, best first.
    equivalent : for each term of `fit`, fits that the data cannot tell from it; without `fit`,
        all fits that cannot be told apart, where they are too many for an answer.
    alone : where `fit` has two effects, the best fit of each of them alone, by term; None where
        the simulator could not run it.
    p_value : for each term, of the hypothesis that it adds nothing to the model with the other.
    gain : of the best candidate on the recalibrated model.
    null_cost : of the recalibrated model, in the metric of the fits.
    reasons : for people.
    """

    verdict: Outcome
    fit: Fit | None = None
    fits: tuple[Fit, ...] = ()
    equivalent: tuple[tuple[Fit, ...], ...] = ()
    alone: tuple[Fit | None, ...] = ()
    p_value: tuple[float, ...] = ()
    gain: float = 0.0
    null_cost: float = 0.0
    reasons: tuple[str, ...] = ()


def margin_of(best: Fit, null_cost: float, size: int) -> float:
    """Return by how much the cost of a fit must be above the best one's to be told from it.

    Parameters
    ----------
    best : the best fit.
    null_cost : cost without an effect.
    size : number of features.
    """
    explained = max(0.0, null_cost - best.cost)
    return SET_MARGIN * best.cost / size + min(
        SET_SHARE[0] * explained, SET_SHARE[1] * best.cost)


def rivals_of(fits: Sequence[Fit], null_cost: float, size: int) -> tuple[Fit, ...]:
    """Return fits of other effects that are as good as the first."""
    best, found = fits[0], []
    names = {best.terms[-1].variant.effect}
    for fit in fits[1:]:
        name = fit.terms[-1].variant.effect
        if name not in names and fit.cost - best.cost < margin_of(best, null_cost, size):
            names.add(name)
            found.append(fit)
    return tuple(found)


def order_of(answer: Answer) -> list[int]:
    """Return the terms of the fit in the order found: the one that explains more alone first."""
    if answer.fit is None:
        return []
    costs = [np.inf if f is None else f.cost for f in answer.alone] or [0.0]
    return [int(k) for k in np.argsort(costs, kind="stable")]


def stages_of(answer: Answer) -> list[Fit]:
    """Return the fits after each effect, in the order found."""
    if answer.fit is None:
        return []
    first = [answer.alone[k] for k in order_of(answer)[:1]] if answer.alone else []
    return [*(f for f in first if f is not None), answer.fit]
