"""Training of the filters for strangers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ema_prognostics.cascade.classes import KINDS_FOUND
from ema_prognostics.cascade.guard import (
    GROUP_SQUEEZE,
    STRANGER_RATE,
    StrangerFilters,
    squeeze,
)
from ema_prognostics.cascade.model_body import FilterPart, StrangersPart, rounded
from ema_prognostics.training.calibration import tail_quantile
from ema_prognostics.training.faults import Stranger
from ema_prognostics.training.guard_training import MARGINS, WITHIN

LEAST_VARIANCE = 0.5
"""Of a residual, which is near 1 over known records by its scale: what never varies in a
simulation does in a machine."""
FEWEST = 5
"""Examples of a kind that give its direction."""
Turned = Callable[[np.ndarray], list[np.ndarray]]


def train_strangers(
    turned: Turned, known: np.ndarray, strange: np.ndarray, what: Sequence[Stranger],
    sound: np.ndarray, other: np.ndarray, kind: np.ndarray,
) -> StrangersPart | None:
    """Return the filters; None where there are too few examples.

    Parameters
    ----------
    turned : gives the guard's residuals of features, as seen from each phase.
    known : ndarray, shape (n, d). Features with and without faults; their scatter.
    strange : ndarray, shape (s, d). Features of strangers.
    what : (s,). What each is.
    sound : ndarray, shape (k, d). Other healthy records; they set the limits.
    other : ndarray, shape (f, d). Others with and without faults; they set those of faults.
    kind : ndarray of int, shape (f,). Of the others: which of `KINDS_FOUND`.
    """
    from sklearn.covariance import ledoit_wolf

    covariance, _ = ledoit_wolf(squeeze(turned(known)[0], GROUP_SQUEEZE), assume_centered=True)
    covariance += np.diag(np.maximum(LEAST_VARIANCE - np.diag(covariance), 0.0))
    views = turned(strange)
    found = {}
    for name in sorted({one.kind for one in what}):
        rows = [k for k, one in enumerate(what) if one.kind == name]
        if len(rows) < FEWEST:
            continue
        # Each as if of phase a, and of positive sign.
        examples = squeeze(np.array([what[k].sign * views[what[k].phase][k] for k in rows]),
                           GROUP_SQUEEZE)
        direction = np.linalg.solve(covariance, examples.mean(axis=0))
        direction /= np.sqrt(direction @ covariance @ direction)
        of_phase = any(what[k].phase for k in rows)
        found[name] = FilterPart(weights=rounded(direction), turns=3 if of_phase else 1,
                                 limits=[1.0] * len(KINDS_FOUND))
    if not found:
        return None
    part = StrangersPart(filters=found)
    filters = StrangerFilters(part)
    limits, others = [_limits(filters.outputs(turned(sound)))], filters.outputs(turned(other))
    for name in KINDS_FOUND[1:]:  # healthy records are of more units: no limit is below
        mine = _limits(others[np.isin(kind, WITHIN[name])])
        limits.append(MARGINS[name] * np.maximum(limits[0], mine))
    return StrangersPart(filters={
        name: one.model_copy(update={"limits": rounded(np.array(limits)[:, k])})
        for k, (name, one) in enumerate(found.items())})


def _limits(size: np.ndarray) -> np.ndarray:
    """Return limits, shape (kinds,), that `STRANGER_RATE` of the records exceed with any filter.

    Parameters
    ----------
    size : ndarray, shape (n, kinds). Of the filters' outputs.
    """
    each = np.array([max(tail_quantile(column, STRANGER_RATE), 1e-3) for column in size.T])
    worst = tail_quantile((size / each).max(axis=1), STRANGER_RATE)
    return np.array(rounded(each * worst))
