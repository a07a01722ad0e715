"""What the best linear detector could find with these features: a bound beside the cascade.

Of healthy tests the features have covariance Σ, a fault of severity x moves them by x s. The
likelihood ratio test of that (Neyman and Pearson 1933) finds nine in ten at a rate of false
alarms α where x √(sᵀ Σ⁻¹ s) = z(1 − α) + z(0.9). sᵀ Σ⁻¹ s is read off the simulated faults, of
whatever phase or direction: the mean of their Mahalanobis distances squared grows by x² of it.
"""

from __future__ import annotations

import numpy as np

from ema_prognostics.cascade.classes import CLASS_OF, FAULTS, OUTPUTS
from ema_prognostics.features.vector import steady
from ema_prognostics.training.fleet import FleetFeatures

FALSE_ALARMS = 0.01
FEWEST, ROUNDS = 5, 20
SMALL, LARGE = 8.0, 100.0
"""Distances, squared, beyond that of a healthy record, between which a fault is small enough for
its features to be linear in it and large enough to be seen."""


def linear_bound(faults: FleetFeatures, healthy: FleetFeatures, *, own: bool) -> dict[str, float]:
    """Return the severity that the best linear detector finds in nine of ten, by class.

    Parameters
    ----------
    faults, healthy : fleets.
    own : with the unit's own baseline: of the differences to it.
    """
    from scipy.stats import norm
    from sklearn.covariance import ledoit_wolf

    names, middle = healthy.names, np.median(healthy.record, axis=0)
    sound, rows = (steady(names, fleet.record, middle) for fleet in (healthy, faults))
    if own:
        sound = sound - steady(names, healthy.baseline, middle)
        rows = rows - steady(names, faults.baseline, middle)
    center, scale = np.median(sound, axis=0), np.maximum(sound.std(axis=0), 1e-9)
    sound = (sound - center) / scale
    covariance, _ = ledoit_wolf(sound[::2])  # the others tell how far a healthy test is from it
    root = np.linalg.cholesky(np.linalg.inv(covariance))
    distance = ((((rows - center) / scale) @ root) ** 2).sum(axis=1)
    usual = float(((sound[1::2] @ root) ** 2).sum(axis=1).mean())
    wanted = float(norm.ppf(1.0 - FALSE_ALARMS) + norm.ppf(0.9))
    found = {}
    alone = (faults.severity > 0.0).sum(axis=1) == 1
    for name in FAULTS:
        columns = [k for k, o in enumerate(OUTPUTS) if CLASS_OF[o] == name]
        size = faults.severity[:, columns].max(axis=1)
        there = alone & (size > 0.0)
        if np.count_nonzero(there) < FEWEST:
            continue
        power = (distance[there] - usual) / size[there] ** 2
        information = float(np.median(power))
        for _ in range(ROUNDS):  # only sizes that are seen and still small, by what was found
            if information <= 0.0:
                break
            low, high = np.sqrt(SMALL / information), np.sqrt(LARGE / information)
            used = (size[there] >= low) & (size[there] <= high)
            if np.count_nonzero(used) < FEWEST:  # such sizes are rare: those nearest to them
                away = np.abs(np.log(size[there] / np.sqrt(low * high)))
                used = away <= np.sort(away)[FEWEST - 1]
            information = float(np.median(power[used]))
        if information > 0.0:
            found[name] = wanted / float(np.sqrt(information))
    return found
