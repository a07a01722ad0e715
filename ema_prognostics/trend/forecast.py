"""When a growing fault reaches a level: growth that may speed up, stall and come in bursts.

The severity of flight n follows ds = (b + d(n)) dtau(n). The time scale tau is n where growth is
steady; where it speeds up, its pace grows by the same part in every flight (a fault that feeds
itself) or by the same amount (one that began at an earlier flight). The deviation d fades within
the memory of bursts and plateaus (an Ornstein-Uhlenbeck process). All of it is linear and
Gaussian once time scale, size and memory of the deviation and the scatter of the flights are
given. So one Kalman filter for each of these tells how well it explains the flights, and runs on
into the future; the forecast is the average, weighted by what each explains times its prior.
Degradation does not heal: a level is passed by flight n where the severity of flight n lies
above it.

Priors: that growth speeds up is as likely as not, either way as likely as the other. The size of
the deviation has half a Cauchy law (A. Gelman, Bayesian Anal. 1 (2006) 515).

Sources: J. F. Archard, J. Appl. Phys. 24 (1953) 981 (steady wear); G. A. Whitmore and
F. Schenkelberg, Lifetime Data Anal. 3 (1997) 27 (both time scales that speed up); P. J. Harrison
and C. F. Stevens, J. R. Stat. Soc. B 38 (1976) 205 (several processes, weighted, and outliers);
Z. W. Birnbaum and S. C. Saunders, J. Appl. Prob. 6 (1969) 319 (passage).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr

from ema_prognostics.trend.growth import INTERVAL, QUANTILE, Growth

HORIZON = 10_000.0
"""Longest forecast (flights)."""
BENDS = np.linspace(0.5, 3.5, 7)
"""Logarithm of the rate now over that at the first flight, where growth speeds up: by the same
part, a priori half a normal law; by the same amount, an exponential law (the first flight is then
as likely at any part of the time since the growth began)."""
WANDERS = np.array([0.01, 0.1, 0.3, 0.8, 2.0])
"""Deviation of the rate, in parts of the mean rate; the first is that of a steady one."""
REGULAR = 0.05
"""Median of its prior, half a Cauchy law: a rate that never turns negative seldom deviates by
more than itself, but may."""
MEMORIES = np.array([0.03, 0.12, 0.5])
"""Of this deviation, in parts of the flights so far."""
SCATTERS = np.array([0.25, 0.5, 1.0])
"""Scatter from flight to flight, in parts of the deviation that the intervals state."""
SHARED = 0.5
"""Part of the variance stated but not seen as scatter that is an error shared by all flights: a
uniform prior's mean, as a stated interval may also be too wide."""
DIFFUSE = 30.0
"""Prior deviation of severity and growth, in parts of the span of the severities."""
OUTLYING = 0.05
"""Flights whose severity may be anything."""
STEPS = 80
"""Of the law, over all flights ahead, and once more where it rises."""
HALVINGS = 40
"""Of the range in which a quantile of the severity is sought."""
NEGLIGIBLE = 1e-3
"""Weight, against the largest, below which a process does not enter the forecast."""


class _Processes(NamedTuple):
    """Processes that are weighed, each of shape (g,), with the logarithm of the prior."""

    bend: np.ndarray
    steadily: np.ndarray
    wander: np.ndarray
    memory: np.ndarray
    scatter: np.ndarray
    prior: np.ndarray


class Forecast(NamedTuple):
    """Flights from now until a level is reached; None: beyond the horizon, or never."""

    median: float | None
    lower: float
    upper: float | None

    def after(self, last: int) -> tuple[int | None, tuple[int, int | None]]:
        """Return the number of the flight that reaches it, and its interval; `last`: of now."""
        median, upper = (None if t is None else last + math.ceil(t)
                         for t in (self.median, self.upper))
        return median, (last + math.ceil(self.lower), upper)


class PassageLaw(NamedTuple):
    """Probability that a level is reached within a number of flights from now."""

    flights: np.ndarray
    """Shape (n,), increasing."""
    probability: np.ndarray
    """Shape (n,); what is missing to 1 at the end lies beyond the horizon."""

    def quantile(self, probability: float) -> float | None:
        """Return the flights within which it is reached with `probability`, or None."""
        if self.probability[-1] < probability:
            return None
        return float(np.interp(probability, self.probability, self.flights))


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlook:
    """What the flights so far say of severity and rate now, process by process.

    Attributes
    ----------
    weight : ndarray, shape (g,). Probability of each process; sum 1.
    acceleration : ndarray, shape (g,). Relative growth of the rate in the next flight.
    steadily : ndarray of bool, shape (g,). Whether the rate goes on growing by as much in every
        flight, else by the same part of itself.
    pace : ndarray, shape (g,). Time scale that passes in a flight, now.
    memory, variance : ndarray, shape (g,). Of the rate's deviation, in flights and (unit of the
        time scale)².
    mean, covariance : ndarray, shapes (3, g), (3, 3, g). Of severity, mean rate and deviation.
    severity : now.
    shared : deviation that all flights of the unit share, in parts of the severity.
    """

    weight: np.ndarray
    acceleration: np.ndarray
    steadily: np.ndarray
    pace: np.ndarray
    memory: np.ndarray
    variance: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    severity: float
    shared: float


def outlook(
    number: np.ndarray, severity: np.ndarray, lower: np.ndarray, upper: np.ndarray,
    found: Growth,
) -> Outlook | None:
    """Return what the flights say of severity and rate now, or None where there is no growth.

    Parameters
    ----------
    number : ndarray, shape (n,). Numbers of the flights, increasing.
    severity, lower, upper : ndarray, shape (n,). With its 90 % interval.
    found : growth of the same flights.
    """
    if not found.growing:
        return None
    growth = found.rate * float(number[-1] - number[0])
    x, y = (number - number[0]).astype(float), severity
    sigma = np.maximum(0.5 * (upper - lower) / QUANTILE, 1e-6 * growth)
    span = float(x[-1])
    of = _processes()
    bend, steadily, scatter, memory = of.bend, of.steadily, of.scatter, of.memory * span
    variance = (of.wander * growth) ** 2
    # From 0 to 1 over the flights, so that all processes share one prior of the growth.
    begin = np.where(steadily, np.expm1(bend), bend) / span
    scale = _elapsed(begin, steadily, x[:, None]) / _elapsed(begin, steadily, span)
    extent = float(np.ptp(y)) + float(sigma.max())
    mean = np.zeros((3, len(bend)))
    mean[0] = y[0]
    covariance = np.zeros((3, 3, len(bend)))
    covariance[[0, 1], [0, 1]] = (DIFFUSE * extent) ** 2
    covariance[2, 2] = variance
    score = of.prior.copy()
    for k in range(len(x)):
        if k:
            mean, covariance = _ahead(mean, covariance, scale[k] - scale[k - 1],
                                      x[k] - x[k - 1], memory, variance)
        likelihood, mean, covariance = _seen(
            mean, covariance, y[k], (scatter * sigma[k]) ** 2, extent**2)
        score += likelihood
    score += log_ndtr(mean[1] / np.sqrt(covariance[1, 1]))  # a mean rate above 0
    weight = np.exp(score - score.max())
    weight /= weight.sum()
    last = slice(-5, None)
    stated = float(np.mean(sigma[last] ** 2))
    shared = SHARED * stated * max(0.0, 1.0 - float(weight @ scatter**2))
    some = np.flatnonzero(weight > NEGLIGIBLE * weight.max())
    end = np.where(steadily, -np.expm1(-bend), bend) / span
    pace = np.exp(bend) / _elapsed(begin, steadily, span)
    return Outlook(
        weight=weight[some] / weight[some].sum(), acceleration=end[some],
        steadily=steadily[some], pace=pace[some], memory=memory[some],
        variance=variance[some], mean=mean[:, some], covariance=covariance[:, :, some],
        severity=found.severity,
        shared=float(np.sqrt(shared)) / max(float(np.median(y[last])), 1e-300),
    )


def passage_law(seen: Outlook, level: float) -> PassageLaw:
    """Return when `level` is reached."""
    coarse = np.concatenate([[0.0], np.geomspace(0.25, HORIZON, STEPS)])
    rough = PassageLaw(coarse, _passed(seen, level, coarse))
    # Finer where it rises.
    begin = min(max(int(np.searchsorted(rough.probability, 0.01)) - 1, 1), STEPS - 1)
    end = min(max(int(np.searchsorted(rough.probability, 0.99)), begin + 1), STEPS)
    fine = np.geomspace(coarse[begin], coarse[end], STEPS)
    flights = np.concatenate([coarse[:begin], fine, coarse[end + 1:]])
    return PassageLaw(flights, _passed(seen, level, flights))


def forecast(seen: Outlook, level: float) -> Forecast | None:
    """Return when `level` is reached, or None where it is reached."""
    if seen.severity >= level:
        return None
    law = passage_law(seen, level)
    tail = 0.5 - 0.5 * INTERVAL
    lower = law.quantile(tail)
    return Forecast(median=law.quantile(0.5), lower=HORIZON if lower is None else lower,
                    upper=law.quantile(1.0 - tail))


def course(seen: Outlook, flights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return median and 90 % bounds of the severity `flights` after the last, each shape (n,).

    Parameters
    ----------
    flights : ndarray, shape (n,). Increasing, from 0.
    """
    found = np.empty((3, len(flights)))
    tail = 0.5 - 0.5 * INTERVAL
    wanted = np.array([0.5, tail, 1.0 - tail])
    for k, (mean, variance) in enumerate(_coming(seen, flights)):
        wide = np.sqrt(variance + (seen.shared * mean) ** 2)
        low = np.full(3, (mean - 4.0 * wide).min())
        high = np.full(3, (mean + 4.0 * wide).max())
        for _ in range(HALVINGS):  # a grid would be coarse where one process runs away
            middle = 0.5 * (low + high)
            below = ndtr((middle[:, None] - mean) / wide) @ seen.weight < wanted
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        found[:, k] = 0.5 * (low + high)
    return found[0], found[1], found[2]


@functools.cache
def _processes() -> _Processes:
    """Return all processes with their priors."""
    part, amount = -0.5 * BENDS**2, -BENDS
    laws = [(0.0, False, 0.5),
            *((b, False, 0.25 * p) for b, p in zip(BENDS, np.exp(part) / np.exp(part).sum())),
            *((b, True, 0.25 * p) for b, p in zip(BENDS, np.exp(amount) / np.exp(amount).sum()))]
    below = 2.0 / np.pi * np.arctan(np.sqrt(WANDERS[1:] * WANDERS[:-1]) / REGULAR)
    share = np.diff([0.0, *below, 1.0])
    wanders = [(WANDERS[0], MEMORIES[-1], share[0]),
               *((w, m, p / len(MEMORIES)) for w, p in zip(WANDERS[1:], share[1:])
                 for m in MEMORIES)]
    rows = [(b, steadily, w, m, s, np.log(p * q)) for b, steadily, p in laws
            for w, m, q in wanders for s in SCATTERS]
    bend, steadily, wander, memory, scatter, prior = np.array(rows).T
    return _Processes(bend, steadily > 0.0, wander, memory, scatter, prior)


def _seen(
    mean: np.ndarray, covariance: np.ndarray, severity: float, noise: np.ndarray, outlier: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return log-likelihood, mean and covariance with one more flight.

    With the probability `OUTLYING` the flight errs by the variance `outlier` besides its `noise`;
    mean and covariance are those of both cases together.
    """
    column = covariance[0]
    error = severity - mean[0]
    spread = column[0] + noise
    spreads = [spread, spread + outlier]
    scores = [np.log(p) - 0.5 * (np.log(f) + error**2 / f)
              for p, f in zip((1.0 - OUTLYING, OUTLYING), spreads)]
    total = np.logaddexp(*scores)
    right = np.exp(scores[0] - total)
    each = [1.0 / f for f in spreads]
    lever = right * each[0] + (1.0 - right) * each[1]
    apart = right * (1.0 - right) * ((each[0] - each[1]) * error) ** 2
    return (total, mean + column * (lever * error),
            covariance + column[:, None] * ((apart - lever) * column))


def _elapsed(acceleration: np.ndarray, steadily: np.ndarray, flights: Any) -> np.ndarray:
    """Return the time scale after `flights`, at a pace of 1 at their begin.

    The pace grows by `acceleration` a flight: of itself, or of what it was at the begin.
    """
    g = np.maximum(acceleration, 1e-9)
    return np.where(steadily, flights * (1.0 + 0.5 * g * flights),
                    np.expm1(np.minimum(g * flights, 50.0)) / g)


def _ahead(
    mean: np.ndarray, covariance: np.ndarray, scale: np.ndarray, flights: float,
    memory: np.ndarray, variance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance after `flights`, in which `scale` of the time scale passes."""
    r = flights / memory
    kept = np.exp(-r)
    lever = scale / r  # of the deviation on the severity: pace times memory
    moved = lever * (1.0 - kept)

    def move(of: np.ndarray) -> np.ndarray:
        return np.stack([of[0] + scale * of[1] + moved * of[2], of[1], kept * of[2]])

    spread = np.where(r < 0.02, r**3 * (2.0 / 3.0 - 0.5 * r), 2.0 * r - 3.0 + 4.0 * kept - kept**2)
    covariance = move(move(covariance).swapaxes(0, 1))
    covariance[0, 0] += variance * lever**2 * spread
    covariance[0, 2] += variance * lever * (1.0 - kept) ** 2
    covariance[2, 0] = covariance[0, 2]
    covariance[2, 2] += variance * (1.0 - kept**2)
    return move(mean), covariance


def _coming(seen: Outlook, flights: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield mean and variance of the severity after each of `flights`, which begin at 0."""
    mean, covariance = seen.mean, seen.covariance
    scale = seen.pace * _elapsed(seen.acceleration, seen.steadily, flights[:, None])
    for k in range(len(flights)):
        if k:
            mean, covariance = _ahead(mean, covariance, scale[k] - scale[k - 1],
                                      flights[k] - flights[k - 1], seen.memory, seen.variance)
        yield mean[0], covariance[0, 0]


def _passed(seen: Outlook, level: float, flights: np.ndarray) -> np.ndarray:
    """Return the probability that `level` is reached within `flights`, which begin at 0."""
    known = (level * seen.shared) ** 2
    each = np.zeros(len(seen.weight))
    passed = np.zeros(len(flights))
    for k, (mean, variance) in enumerate(_coming(seen, flights)):
        each = np.maximum(each, ndtr((mean - level) / np.sqrt(variance + known)))
        passed[k] = seen.weight @ each
        if passed[k] > 1.0 - 1e-6:
            passed[k:] = 1.0
            break
    return passed
