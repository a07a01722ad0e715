"""Which laws may be added to a balance, each with the shapes that are tried."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from ema_identification.rig.balance import BASE_LAWS, Balance
from ema_identification.rig.laws import LAWS, Law, Term

Candidate = tuple[str, tuple[Term, ...]]
"""The name under which it is reported; a term, and one that sharpens it."""


def candidate_terms(
    balance: Balance, hidden: Collection[str], peaks: Sequence[float] = ()
) -> list[Candidate]:
    """Return what may be added to a balance.

    Parameters
    ----------
    balance : Balance
        The model so far.
    hidden : collection of str
        Names that may not be used.
    peaks : sequence of float
        Frequencies at which the residual has a wave in time (Hz).

    """
    present = {term.law.name for term in balance.terms}
    keys = {term.key for term in balance.terms}
    trajectory = balance.design.trajectory
    found: list[Candidate] = []
    for law in LAWS.values():
        if law.name in BASE_LAWS or (law.name in present and not law.repeats):
            name = _changed(balance, law)
            if name and name not in hidden:
                found.append((name, (_own(balance, law),)))
            continue
        if law.name in hidden or not law.applies(trajectory):
            continue
        if (law.of_prediction and not balance.terms) or present & set(law.excludes):
            continue
        needed = set(law.requires) - present
        if needed and (not law.sharpens or needed & set(hidden)):
            continue
        found += [(name, (Term(law=LAWS[name]), Term(law=law)))
                  for name in law.joins if name not in present and name not in hidden]
        before = tuple(Term(law=LAWS[name]) for name in sorted(needed))
        found += [(before[0].law.name if before else law.name,
                   (*before, Term(law=law, shape=tuple(shape))))
                  for shape in ([(f,) for f in peaks] if law.looked_for
                                else law.grid(trajectory))
                  if Term(law=law, shape=tuple(shape)).key not in keys]
    return found


def _own(balance: Balance, law: Law) -> Term:
    """Return the model's term of a law, or a new one."""
    return next((term for term in balance.terms if term.law.name == law.name), Term(law=law))


def _changed(balance: Balance, law: Law) -> str | None:
    """Return the name for a known term that is missing, or stands at its bound."""
    if law.name in balance.names:
        index = len(balance.terms) - 1 - balance.names[::-1].index(law.name)
        span = balance.span(index)
        at_bound = balance.fixed[span] & np.isfinite(balance.bounds.high[span])
        if not at_bound.any():
            return None
        return "inertia_change" if law.name == "inertia" else law.name
    if law.name == "disturbance" and not balance.design.trajectory.has_disturbance:
        return None
    return law.name
