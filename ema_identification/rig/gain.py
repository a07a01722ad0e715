"""Known terms that are all off by one factor: a gain of the input looks the same."""

from __future__ import annotations

import numpy as np

from ema_identification.rig.balance import Balance

ALIKE = 0.05
"""Spread of the factors, over their mean, within which they count as one."""


def common_factor(start: Balance, end: Balance) -> float | None:
    """Return the factor by which all known terms differ from the model, None without one.

    Parameters
    ----------
    start : Balance
        The model as given; terms with bounds are known.
    end : Balance
        With what was found; one of the known terms was replaced.

    Returns
    -------
    float or None
        Only where two known terms or more share it and it is beyond `ALIKE`.

    """
    factors = []
    replaced = False
    for index, term in enumerate(start.terms):
        span = start.span(index)
        low, high = start.bounds.low[span], start.bounds.high[span]
        if len(low) != 1 or term.law.dynamic or not np.isfinite(high[0]) or not low[0] + high[0]:
            continue
        own = index
        if end.replaced(index):
            replaced = True
            own = len(end.names) - 1 - end.names[::-1].index(term.law.name)
        value = float(end.fit.coefficients[end.span(own)][0])
        factors.append(2.0 * value / float(low[0] + high[0]))
    if not replaced or len(factors) < 2:
        return None
    mean = float(np.mean(factors))
    if max(factors) - min(factors) > ALIKE * abs(mean) or abs(mean - 1.0) <= ALIKE:
        return None
    return mean
