"""Growth that no single flight can announce: a sequential test over the flights' evidence.

Every verdict gives a probability of each class, also a healthy one. Its rank among the flights
so far is free of any distribution: without growth the ranks are independent, rank t uniform on
1 to t. As normal scores they enter a cumulative sum, whose mean number of flights to a false
alarm is known.

Sources: W. J. Conover, V. G. Tercero-Gómez, A. E. Cordero-Franco, Qual. Reliab. Eng. Int. 33
(2017) 2323 (sequential normal scores); E. S. Page, Biometrika 41 (1954) 100 (cumulative sum);
D. Siegmund, Sequential Analysis (1985) (its run length).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

from ema_prognostics.trend.flights import Flight

ALLOWANCE = 0.5
"""Part of a standard deviation that each flight's score is lowered by."""
LIMIT = 5.75
"""Of the sum: a false suspicion once in 2,000 flights a class, by the run length of Siegmund."""


def sequential_scores(values: np.ndarray) -> np.ndarray:
    """Return the normal score of each value's rank among those up to it, shape (n,).

    Equal values share their middle rank. The first score is 0.
    """
    scores = np.zeros(len(values))
    for t in range(1, len(values) + 1):
        so_far = values[:t]
        rank = np.sum(so_far < so_far[-1]) + 0.5 * (np.sum(so_far == so_far[-1]) + 1.0)
        scores[t - 1] = ndtri((rank - 0.5) / t)
    return scores


def cumulative_sum(scores: np.ndarray) -> np.ndarray:
    """Return S_t = max(0, S_(t−1) + score_t − `ALLOWANCE`), shape (n,)."""
    total, sums = 0.0, np.empty(len(scores))
    for t, score in enumerate(scores):
        total = max(0.0, total + float(score) - ALLOWANCE)
        sums[t] = total
    return sums


def suspicion(flights: Sequence[Flight], fault_class: str, *, begin: int = 1) -> int | None:
    """Return the number of the flight from which growth of a class is suspected, or None.

    A suspicion ends where the sum is back at zero: what spoke for growth is used up.

    Parameters
    ----------
    flights : of one actuator, in order.
    fault_class : its probability is the evidence, ranked among the flights of the same test.
    begin : first flight that counts, the one after a repair.
    """
    used = [
        f for f in flights
        if f.answered and f.number >= begin and fault_class in f.verdict.probabilities
    ]
    values = np.array([f.verdict.probabilities[fault_class] for f in used])
    tests = np.array([f.profile for f in used])
    scores = np.zeros(len(used))
    for test in set(tests.tolist()):
        scores[tests == test] = sequential_scores(values[tests == test])
    sums = cumulative_sum(scores)
    begun = int(np.flatnonzero(np.append(0.0, sums) == 0.0)[-1])
    above = np.flatnonzero(sums[begun:] > LIMIT)
    return used[begun + int(above[0])].number if len(above) else None
