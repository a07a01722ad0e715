"""Whether a kit is good enough: its model describes the records, its cascade knows them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ema_prognostics.cascade.find import Cascade
from ema_prognostics.commission.discrepancy import NOT_SHIFTED, fit_discrepancy
from ema_prognostics.features.vector import steady
from ema_prognostics.training.evaluation import outcome_of
from ema_prognostics.training.fleet import FleetFeatures
from ema_prognostics.verdict.diagnose import corrected_row
from ema_prognostics.words import ENGLISH, feature_words
from ema_record.errors import UsageError

MOST_FALSE_ALARMS, MOST_UNKNOWN = 0.01, 0.05
"""Of the kit's own fleet, and of the acceptance records left out: above, no kit is made."""
MOST_NEW_UNKNOWN = 0.03
"""Of healthy records of other units, the requirement."""
WIDEN = 2.0
"""Most by which the guard's limits are widened so that healthy records pass: beyond, it is not
the recorder that is unlike the model."""
WORST, MOST_BEYOND = 8.0, 3
"""Healthy deviations that a feature of the corrected model may be off in the mean of the records,
and how many features may be more: beyond, the model does not describe the actuator."""


def check_described(
    names: Sequence[str], rows: np.ndarray, model: np.ndarray, spread: np.ndarray
) -> None:
    """Raise UsageError where the corrected model does not give the records.

    Parameters
    ----------
    names : of the features, (d,).
    rows, model : ndarray, shape (n, d). Of the records and of the corrected model.
    spread : ndarray, shape (d,). Over healthy tests.
    """
    off = np.abs((rows - model).mean(axis=0)) / spread
    off[[n.startswith(NOT_SHIFTED) for n in names]] = 0.0
    if np.count_nonzero(off > WORST) > MOST_BEYOND:
        worst = [f"{feature_words(names[k], ENGLISH)} by {off[k]:.0f}"
                 for k in np.argsort(-off)[:3]]
        raise UsageError(
            f"the description does not give these records: {', '.join(worst)} healthy "
            f"deviations, at most {WORST:g}: check drive, gear, pole pairs, inertia and the "
            "control gains of the description")


def fleet_spread(names: list[str], fleet: FleetFeatures) -> np.ndarray:
    """Return the standard deviation of features over healthy tests, shape (d,), never 0."""
    missing = [n for n in names if n not in fleet.names]
    if missing:
        raise UsageError(f"the records hold {missing[0]!r}, the model does not: does the "
                         "description say which channels are recorded?")
    rows = fleet.both(names)
    rows = steady(names, rows, np.median(rows, axis=0))
    low, high = np.quantile(rows, [0.16, 0.84], axis=0)
    return np.asarray(np.maximum.reduce([
        0.5 * (high - low), 0.5 * rows.std(axis=0), 1e-3 + 1e-3 * np.abs(rows).mean(axis=0)]))


def largest(names: Sequence[str], z: np.ndarray) -> list[dict[str, Any]]:
    """Return the ten features that are off the most, in healthy deviations, largest first."""
    order = np.argsort(-np.abs(z))
    return [{"feature": names[k], "deviations": float(z[k])} for k in order[:10]]


def too_many_alarms(views: dict[str, Any]) -> bool:
    """Whether the validation of a test shows more false alarms than a kit may have."""
    alarms = views["fleet"]["false alarms"]
    return bool(alarms["count"] > MOST_FALSE_ALARMS * alarms["total"])


def check_good(found: dict[str, Any]) -> None:
    """Raise UsageError unless the kit is good enough to be used."""
    wrong = [r for r in found["records"] if r["left_out"] not in ("healthy", "unknown")]
    if wrong:
        raise UsageError(
            f"{wrong[0]['bag']} (unit {wrong[0]['serial_number']}) is judged as "
            f"{wrong[0]['left_out'].replace('_', ' ')} beside the other units: leave out that "
            "unit, acceptance records must be of healthy ones")
    unknown = found["healthy_left_out_unknown"]
    if unknown["hits"] > MOST_UNKNOWN * unknown["total"]:
        odd = next(r for r in found["records"] if r["left_out"] == "unknown")
        raise UsageError(
            f"{unknown['hits']} of {unknown['total']} acceptance records left out are unknown to "
            f"a kit made of the others, at most {100 * MOST_UNKNOWN:g} % may be ({odd['bag']} for "
            "one): give records of more units, or wider tolerances")
    for views in found["held_out"].values():
        alarms = views["fleet"]["false alarms"]
        if too_many_alarms(views):
            raise UsageError(
                f"{alarms['count']} of {alarms['total']} healthy tests of the kit's own fleet are "
                f"false alarms, at most {100 * MOST_FALSE_ALARMS:g} %: train without --quick, or "
                "give tighter tolerances")


def judge_left_out(
    fleet: Cascade, names: list[str], rows: np.ndarray, units: np.ndarray, model: np.ndarray,
    spread: np.ndarray,
) -> tuple[list[str], tuple[float, float]]:
    """Return the outcome of each acceptance record, and by what limits grow for them.

    They are those of the guard and those of the filters for strangers. The discrepancy is that
    of the other units; the outcomes are those by the wider limits.

    Parameters
    ----------
    fleet : the cascade without baseline.
    names, rows, units, model, spread : as of `fit_discrepancy`.
    """
    outcomes, scores = [], []
    for row, unit in zip(rows, units):
        others = units != unit
        left = fit_discrepancy(names, rows[others], units[others], model[others], spread)
        x = corrected_row(dict(zip(names, row)), fleet.view.names, left)
        detection = fleet.find(x)[0]
        outcomes.append(outcome_of(detection))
        judged = not detection.outputs and not detection.doubtful
        scores.append([float(detection.guard.max()), detection.stranger] if judged
                      else [np.inf, np.inf])
    guard, strangers = (widening(np.array(column)) for column in zip(*scores))
    return ["healthy" if o == "unknown" and g <= guard and s <= strangers else o
            for o, (g, s) in zip(outcomes, scores)], (guard, strangers)


def widening(scores: np.ndarray) -> float:
    """Return by what the guard's limits grow so that new healthy records pass, 1 to `WIDEN`.

    The bound under which the next score of a normal sample lies with probability 1 -
    `MOST_NEW_UNKNOWN` (Hahn and Meeker 1991, section 4.8): acceptance records are few, and their
    largest is no bound of what comes.

    Parameters
    ----------
    scores : ndarray, shape (n,). The largest for each record that was left out; infinite: it is
        unknown for another reason.
    """
    from scipy.stats import t

    known = scores[np.isfinite(scores)]
    n = len(known)
    if n < 2:
        return 1.0
    bound = known.mean() + t.ppf(1.0 - MOST_NEW_UNKNOWN, n - 1) * known.std(ddof=1) * np.sqrt(
        1.0 + 1.0 / n)
    return float(np.clip(bound, 1.0, WIDEN))
