"""How rare something is among healthy units that built nothing of the library."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import betaincinv

from ema_identification.actuator.laws.terms import SURE

LEVEL = 0.01
"""Requirement: names on nothing, at most 1 %. Of every test."""


def rank(score: float, healthy: np.ndarray) -> float:
    """Return the probability of a score as large among units that are exchangeable."""
    return float(1.0 + (healthy >= score).sum()) / (1.0 + len(healthy))


def p_nothing(score: Sequence[float], healthy: np.ndarray) -> float:
    """Return the share of healthy units that are as far off, with `SURE` at most as large.

    Each number counts in units of what the share `LEVEL` of the units exceeds in it, and the
    largest is ranked: having looked at all is paid for, and one that is far
    beyond all healthy units is enough, the others being usual. (The rarest of their ranks never
    is: the farthest healthy unit in each is as rare.) Of `n` healthy units `k` are
    as far off: the bound of Clopper and Pearson (1934). Among all libraries that might have been
    drawn, at least `SURE` keep what it promises.
    """
    pooled = np.vstack([score, healthy])
    scale = np.maximum(np.quantile(pooled, 1.0 - LEVEL, axis=0), 1e-9)
    farthest = (pooled / scale).max(axis=1)
    return share_of(int((farthest[1:] >= farthest[0]).sum()), len(healthy))


def share_of(as_rare: int, units: int) -> float:
    """Return the largest share that is compatible, with `SURE`, with so many of `units`."""
    return float(betaincinv(as_rare + 1, units - as_rare, SURE)) if as_rare < units else 1.0


def both_of(one: float, other: float) -> float:
    """Return how often two independent p-values are as small together (Fisher, 1925)."""
    return one * other * (1.0 - math.log(one * other))
