"""What was decided of a record, and the evidence that models are compared by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ema_identification.actuator.decision.ranks import LEVEL
from ema_identification.actuator.fleet.surrogate import FleetLibrary
from ema_identification.actuator.laws.terms import LawFit, LawGap, Posterior
from ema_identification.result import Outcome


@dataclass(frozen=True, kw_only=True)
class FleetAnswer:
    """What was decided.

    Attributes
    ----------
    verdict : of the identification.
    null : the model without a law, on runs where laws were tried.
    fit : of the laws named; None for none.
    equivalent : for each law other names that the data cannot tell from it; without `fit`, all
        that explain it equally well.
    p_value : of each law, that it adds nothing to the model with the others.
    p_nothing : that a healthy unit is as far off.
    closed : for each law the share of the excess misfit that it closes, beside the others.
    alone : of two laws, the fit of each without the other.
    fits : all that were compared, most evidence first.
    known : what the records tell of `fit`, its laws and the unit's numbers.
    gap : on held-out records.
    reasons : for people.
    """

    verdict: Outcome
    null: LawFit
    fit: LawFit | None = None
    equivalent: tuple[tuple[str, ...], ...] = ()
    p_value: tuple[float, ...] = ()
    p_nothing: float = 1.0
    closed: tuple[float, ...] = ()
    alone: tuple[LawFit, ...] = ()
    fits: tuple[LawFit, ...] = ()
    known: Posterior | None = None
    gap: LawGap | None = None
    reasons: tuple[str, ...] = field(default=())


def stages_of(answer: FleetAnswer) -> list[LawFit]:
    """Return the model without a law and after each one, the one that closes more first."""
    if answer.fit is None:
        return [answer.null]
    first = [answer.alone[order_of(answer)[0]]] if answer.alone else []
    return [answer.null, *(f for f in first if np.isfinite(f.cost)), answer.fit]


def order_of(answer: FleetAnswer) -> list[int]:
    """Return the places of the laws named, the one that alone leaves least first."""
    costs = [f.cost for f in answer.alone]
    return [int(k) for k in np.argsort(costs)] if costs else [0]


def log_evidence(fit: LawFit, library: FleetLibrary) -> float:
    """Return log E, see `decide`; -inf for a model that could not be run."""
    if not np.isfinite(fit.cost):
        return -np.inf
    nu, names = library.freedom, len({s.variant.effect for s in library.signatures})
    return -float(0.5 * nu * np.log(fit.cost) + 0.5 * fit.free * np.log(nu)
                  + (len(fit.terms) * np.log(names / LEVEL) if fit.terms else 0.0))


def instead_of(fit: LawFit, name: str, kept: Sequence[frozenset[str]]) -> tuple[str, ...]:
    """Return names that stand in the place of one, all else equal."""
    others = set(fit.names) - {name}
    return tuple(sorted({next(iter(k - others)) for k in kept
                         if len(k) == len(fit.names) and others <= k and name not in k}))
