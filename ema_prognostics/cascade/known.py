"""How sure it is that a record is of a kind that the networks know.

The worst score of the guard has a tail probability p among known records. A stranger makes it
small; how small is not known, so the bound of Sellke, Bayarri and Berger (2001) stands for the
odds: a known record is at least −e p ln p times as likely as the best alternative.
"""

from __future__ import annotations

import numpy as np

from ema_prognostics.cascade.classes import CLASS_OF, OUTPUTS, scale_of

KINDS_FOUND = ("healthy", "slight", "mechanical", "electrical", "both")
"""What may be found in a record: no fault, none that is clear, and where one is: friction or
backlash, a short or eccentricity, both."""
TAIL_RATES = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
STRANGERS = 0.04
"""Odds of a stranger before the record is seen."""
ELECTRICAL = 5
"""The first outputs, of `classes.OUTPUTS`, are shorts and eccentricity."""
CLEAR = {"turn_short": 0.03, "rotor_eccentricity": 0.01, "friction": 0.2, "backlash": 3.0}
"""Severity, in `classes.scale_of`, from which a fault is clear, and the guard's limits are wider:
it then moves features beside its own (the last two), or nothing but a fault looks like that (the
first two)."""


def kind_found(severity: np.ndarray) -> np.ndarray:
    """Return the place in `KINDS_FOUND`, shape (n,), of records with faults of `severity`.

    Parameters
    ----------
    severity : ndarray, shape (n, 8). Of each output; 0: it is not there.
    """
    electrical = (severity[:, :ELECTRICAL] > 0.0).any(axis=1)
    mechanical = (severity[:, ELECTRICAL:] > 0.0).any(axis=1)
    least = [scale_of(CLASS_OF[o]) * CLEAR[CLASS_OF[o]] for o in OUTPUTS]
    clear = (severity >= np.array(least)).any(axis=1)
    kinds = [
        ("both", clear & mechanical & electrical), ("mechanical", clear & mechanical),
        ("electrical", clear & electrical), ("slight", mechanical | electrical),
    ]
    return np.select([where for _, where in kinds],
                     [KINDS_FOUND.index(name) for name, _ in kinds],
                     default=KINDS_FOUND.index("healthy"))


def tail_probability(score: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """Return how often a known record scores more, shape (n,); beyond the table its trend.

    Parameters
    ----------
    score : ndarray, shape (n,). Worst score of each record.
    tail : ndarray, shape (8,). Scores exceeded at `TAIL_RATES`, growing.
    """
    log_rate = np.log(TAIL_RATES)
    found = np.interp(score, tail, log_rate)
    slope = (log_rate[-1] - log_rate[-3]) / max(float(tail[-1] - tail[-3]), 1e-3)
    beyond = score > tail[-1]
    found[beyond] = log_rate[-1] + slope * (score[beyond] - tail[-1])
    return np.exp(found)


def probability_known(p: np.ndarray) -> np.ndarray:
    """Return the probability that a record is of a known kind, shape (n,), from its tail p."""
    small = np.clip(p, 1e-12, np.exp(-1.0))
    return 1.0 / (1.0 + STRANGERS / (-np.e * small * np.log(small)))
