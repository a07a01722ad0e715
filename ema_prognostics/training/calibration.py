"""Thresholds and interval widths from records that no network was trained on."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

BORNE_OUT = 40
"""Records by which a probability is told: a standard error of 0.08 or less."""
TILT = 0.01
"""Rise of what is meant where as much is said of it, a unit of what is said."""
BIN, MOST_BINS = 80, 6
"""Fewest residuals a bin, and most bins, where a half width depends on a value."""


def tail_quantile(score: np.ndarray, rate: float) -> float:
    """Return the value that `score` exceeds at `rate`, beyond the largest value if need be.

    The upper tail is taken as a generalised Pareto distribution (method of moments, Hosking
    and Wallis 1987): one per cent of the values, or the largest 60 if these are more, a fifth at
    most. Of a tail of fewer than five, or a rate that is not in it, the value itself that is
    exceeded no more often, but none below the tail.

    Parameters
    ----------
    score : ndarray, shape (n,). Finite.
    rate : probability of exceeding the result.
    """
    tail = min(max(0.01, 60.0 / len(score)), 0.2)
    base = float(np.quantile(score, 1.0 - tail))
    excess = score[score > base] - base
    if len(excess) < 5 or float(excess.std()) <= 0.0 or rate >= tail:
        return max(base, float(np.quantile(score, 1.0 - rate, method="higher")))
    ratio = float(excess.mean()) ** 2 / float(excess.var())
    shape = float(np.clip(0.5 * (1.0 - ratio), -0.5, 0.3))
    scale = float(excess.mean()) * (1.0 - shape)
    if abs(shape) < 1e-6:
        return base + scale * float(np.log(tail / rate))
    return base + scale / shape * ((rate / tail) ** -shape - 1.0)


def conformal_quantile(residual: np.ndarray, coverage: float) -> float:
    """Return the split-conformal half width: covers a new residual with `coverage`.

    Parameters
    ----------
    residual : ndarray, shape (n,). Absolute residuals of a calibration set.
    """
    n = len(residual)
    rank = min(n, int(np.ceil((n + 1) * coverage)))
    return float(np.sort(residual)[rank - 1])


def local_quantiles(
    value: np.ndarray, residual: np.ndarray, coverage: float, most_bins: int = MOST_BINS,
) -> tuple[np.ndarray, np.ndarray]:
    """Return split-conformal half widths that depend on a value: bins of as many residuals each.

    The median value of each bin, growing, stands before them, either of shape (k,).

    Parameters
    ----------
    value, residual : ndarray, shape (n,). What the width depends on; absolute residuals.
    coverage : of new residuals.
    most_bins : however many the residuals.
    """
    bins = min(max(len(value) // BIN, 1), most_bins)
    order = np.argsort(value, kind="stable")
    parts = np.array_split(order, bins)
    return (np.array([np.median(value[p]) for p in parts]),
            np.array([conformal_quantile(residual[p], coverage) for p in parts]))


def borne_out(said: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what logits mean: how often it is so, never less where more is said.

    Isotonic regression (Zadrozny and Elkan 2002) of the share in groups of `BORNE_OUT` records,
    each a half record away from none and all.

    Parameters
    ----------
    said : ndarray, shape (n,). Logits.
    there : ndarray of bool, shape (n,). Whether it is so.

    Returns
    -------
    ndarray, shape (k,), logits that are said, growing; ndarray, shape (k,), those that are meant:
    of the first and last group of each level, `TILT` rising, so that the order stays.
    """
    from sklearn.isotonic import isotonic_regression

    order = np.argsort(said, kind="stable")
    groups = np.array_split(order, max(len(order) // BORNE_OUT, 1))
    middle = np.array([np.median(said[g]) for g in groups])
    share = isotonic_regression([there[g].mean() for g in groups],
                                sample_weight=[len(g) for g in groups])
    ends = [0, *(np.flatnonzero(np.diff(share)) + 1).tolist(), len(groups)]
    knots, logits = [], []
    for first, last in pairwise(ends):
        there_in = np.concatenate([there[g] for g in groups[first:last]])
        hits = (there_in.sum() + 0.5) / (len(there_in) + 1.0)
        for knot in dict.fromkeys((middle[first], middle[last - 1])):
            knots.append(knot)
            logits.append(np.log(hits / (1.0 - hits)))
    return np.array(knots), np.maximum.accumulate(logits) + TILT * (np.array(knots) - knots[0])
