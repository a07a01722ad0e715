"""Training of the filters for strangers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ema_prognostics.cascade.classes import KINDS_FOUND
from ema_prognostics.cascade.guard import PATTERNS, STRANGER_RATE, StrangerFilters
from ema_prognostics.cascade.model_body import FilterPart, StrangersPart, rounded
from ema_prognostics.training.calibration import tail_quantile
from ema_prognostics.training.faults import Stranger
from ema_prognostics.training.guard_training import MARGINS, WITHIN

LEAST_VARIANCE = 0.5
"""Of an input, which is near 1 over healthy records by its spread: what never varies in a
simulation does in a machine."""
FEWEST = 5
"""Examples of a kind that give its direction."""
Turned = Callable[[np.ndarray], list[np.ndarray]]


def train_strangers(
    names: Sequence[str], turned: Turned, known: np.ndarray, known_kind: np.ndarray,
    strange: np.ndarray, what: Sequence[Stranger], sound: np.ndarray, other: np.ndarray,
    kind: np.ndarray,
) -> StrangersPart | None:
    """Return the filters; None where there are too few examples.

    Parameters
    ----------
    names : of the inputs.
    turned : gives the squashed inputs of features, as seen from each phase.
    known : ndarray, shape (n, d). Features with and without faults; their scatter.
    known_kind : ndarray of int, shape (n,). Of the known: which of `KINDS_FOUND`.
    strange : ndarray, shape (s, d). Features of strangers.
    what : (s,). What each is.
    sound : ndarray, shape (k, d). Other healthy records; they set the limits.
    other : ndarray, shape (f, d). Others with and without faults; they set those of faults.
    kind : ndarray of int, shape (f,). Of the others: which of `KINDS_FOUND`.
    """
    inputs, views = turned(known)[0], turned(strange)
    within = [WITHIN.get(name, (0,)) for name in KINDS_FOUND]
    scatter = [_covariance(inputs[np.isin(known_kind, kinds)]) for kinds in within]
    found = {}
    for name in sorted({one.kind for one in what}):
        rows = [k for k, one in enumerate(what) if one.kind == name]
        if len(rows) < FEWEST:
            continue
        # Each as if of phase a, and of positive sign.
        mean = np.mean([what[k].sign * views[what[k].phase][k] for k in rows], axis=0)
        directions = [np.linalg.solve(covariance, mean) for covariance in scatter]
        found[name] = FilterPart(
            weights=rounded(np.array([w / np.sqrt(w @ mean) for w in directions])),
            turns=3 if any(what[k].phase for k in rows) else 1,
            both=any(what[k].sign < 0.0 for k in rows), limits=[1.0] * len(KINDS_FOUND))
    if not found:
        return None
    for name, of in PATTERNS.items():
        if of in names:
            found[name] = FilterPart(
                weights=[[float(n == of) for n in names]] * len(KINDS_FOUND), turns=1, both=False,
                limits=[1.0] * len(KINDS_FOUND))
    filters = StrangerFilters(StrangersPart(filters=found))
    sounds, others, limits = turned(sound), turned(other), []
    for k, name in enumerate(KINDS_FOUND):  # healthy records are of more units: none is below
        limit = _limits(filters.outputs(sounds, k))
        if k:
            mine = np.isin(kind, within[k])
            limit = MARGINS[name] * np.maximum(
                limit, _limits(filters.outputs([z[mine] for z in others], k)))
        limits.append(limit)
    return StrangersPart(filters={
        name: one.model_copy(update={"limits": rounded(np.array(limits)[:, k])})
        for k, (name, one) in enumerate(found.items())})


def _covariance(inputs: np.ndarray) -> np.ndarray:
    """Return the covariance of squashed inputs, shape (n, d), about the healthy centre."""
    from sklearn.covariance import ledoit_wolf

    covariance: np.ndarray = ledoit_wolf(inputs, assume_centered=True)[0]
    return covariance + np.diag(np.maximum(LEAST_VARIANCE - np.diag(covariance), 0.0))


def _limits(size: np.ndarray) -> np.ndarray:
    """Return limits, shape (kinds,): at most `STRANGER_RATE` of the records exceed any of them.

    Each by its own tail, at an equal share of the rate (Bonferroni): a filter whose outputs have a
    heavy tail widens no other's limit.

    Parameters
    ----------
    size : ndarray, shape (n, kinds). Of the filters' outputs.
    """
    rate = STRANGER_RATE / size.shape[1]
    return np.array(rounded(np.array([
        max(tail_quantile(column, rate), float(np.quantile(column, 1.0 - rate)), 1e-3)
        for column in size.T])))
