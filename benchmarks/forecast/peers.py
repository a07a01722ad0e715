"""Forecasters of one sequence of severities: `ema trend`'s and the others.

Each gives equally likely numbers of flights from now until the level is reached, `HORIZON` for
later or never, or None where it gives no forecast.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri

from ema_prognostics.trend.forecast import HORIZON, outlook, passage_law
from ema_prognostics.trend.growth import MIN_FLIGHTS, QUANTILE, Growth, growth

SHARES = (np.arange(200) + 0.5) / 200
PARTICLES = 500
LONGEST_WALK = 600
"""Flights that the particles are followed."""


class Seen(NamedTuple):
    """Flights since the last repair, each of shape (n,), and the level asked about."""

    number: np.ndarray
    severity: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    level: float

    @property
    def deviation(self) -> np.ndarray:
        """That the intervals state, shape (n,)."""
        return 0.5 * (self.upper - self.lower) / QUANTILE

    def growth(self) -> Growth | None:
        """Return the growth if there is one and the level is not reached."""
        found = growth(self.number, self.severity, self.lower, self.upper)
        if found is None or not found.growing or found.severity >= self.level:
            return None
        return found


Forecaster = Callable[[Seen, np.random.Generator], np.ndarray | None]


def of_the_trend(seen: Seen, _rng: np.random.Generator) -> np.ndarray | None:
    """Forecast as `ema trend` does."""
    found = seen.growth()
    view = None if found is None else outlook(*seen[:4], found)
    if view is None:
        return None
    law = passage_law(view, seen.level)
    return np.array([HORIZON if t is None else t for t in map(law.quantile, SHARES)])


def passage_probability(
    t: np.ndarray, distance: float, drift: np.ndarray, wander: float
) -> np.ndarray:
    """Return the probability that a Wiener process has passed `distance` > 0 by time `t`.

    Inverse Gaussian; `wander` is the variance a unit of time (J. L. Folks and R. S. Chhikara,
    J. R. Stat. Soc. B 40 (1978) 263).
    """
    root = np.sqrt(wander * t)
    mirrored = 2.0 * drift * distance / wander + log_ndtr(-(drift * t + distance) / root)
    return ndtr((drift * t - distance) / root) + np.exp(np.minimum(mirrored, 0.0))


def median_slope(seen: Seen, _rng: np.random.Generator) -> np.ndarray | None:
    """Forecast by the median of the slopes, its interval and a Wiener process.

    What `ema trend` did before it knew growth that speeds up.
    """
    found = seen.growth()
    if found is None:
        return None
    low, high = found.rate_interval
    nodes = ndtri((np.arange(41) + 0.5) / 41.0)
    side = np.where(nodes < 0.0, found.rate - low, high - found.rate) / QUANTILE
    drift = found.rate + nodes * side
    errors = found.severity_error * np.array([-1.2247, 0.0, 1.2247])
    distances = seen.level - found.severity - errors
    wander = max(found.wander, 1e-6 * (seen.level - found.severity) * found.rate)
    t = np.geomspace(0.05, HORIZON, 800)
    law = sum(w * (passage_probability(t[:, None], d, drift, wander).mean(axis=1)
                   if d > 0.0 else np.ones(len(t)))
              for w, d in zip((1 / 6, 4 / 6, 1 / 6), distances))
    return np.interp(SHARES, np.asarray(law), t, right=HORIZON)


def bayesian_line(seen: Seen, rng: np.random.Generator) -> np.ndarray | None:
    """Forecast by a straight line with the conjugate posterior of a flat prior."""
    n = len(seen.number)
    if n < MIN_FLIGHTS:
        return None
    x = seen.number - float(seen.number[-1])
    design = np.stack([np.ones(n), x], axis=1)
    inverse = np.linalg.inv(design.T @ design)
    best = inverse @ design.T @ seen.severity
    rest = float(np.sum((seen.severity - design @ best) ** 2))
    variance = rest / rng.chisquare(n - 2, len(SHARES))
    root = np.linalg.cholesky(inverse)
    now, rate = (best[:, None] + np.sqrt(variance) * (
        root @ rng.standard_normal((2, len(SHARES)))))
    if best[0] >= seen.level:
        return None
    passed = np.maximum(seen.level - now, 0.0) / np.where(rate > 0.0, rate, np.inf)
    return np.where(rate > 0.0, np.minimum(passed, HORIZON), HORIZON)


def particle_filter(seen: Seen, rng: np.random.Generator) -> np.ndarray | None:
    """Forecast by progpy's particle filter on the crack law ds/dn = c s^m, c and m unknown.

    Severity in parts of the level; the particles then walk on with the model's own noise.
    """
    from progpy.state_estimators import ParticleFilter
    from progpy.uncertain_data import UnweightedSamples

    if len(seen.number) < MIN_FLIGHTS:
        return None
    np.random.seed(rng.integers(1 << 31))  # noqa: NPY002 - progpy draws from the global state
    y, sigma = seen.severity / seen.level, seen.deviation / seen.level
    span = float(seen.number[-1] - seen.number[0])
    first = np.maximum(y[0] + sigma[0] * rng.standard_normal(PARTICLES), 1e-6)
    exponent = rng.uniform(0.0, 2.0, PARTICLES)
    rate = rng.normal(np.log(1.0 / span), 1.0, PARTICLES) - exponent * np.log(max(y[0], 1e-6))
    model = _crack_law()(process_noise={"s": 0.0, "log_c": 0.05, "m": 0.02})
    start = UnweightedSamples({"s": first, "log_c": rate, "m": exponent},
                              _type=model.StateContainer)
    tracked = ParticleFilter(model, start, t0=0.0, dt=1.0,
                             measurement_noise={"s": float(sigma[0])})
    for k in range(1, len(y)):
        tracked.parameters["measurement_noise"] = {"s": max(float(sigma[k]), 1e-9)}
        tracked.estimate(float(seen.number[k] - seen.number[0]), {}, {"s": float(y[k])})
    x = tracked.particles
    if np.median(x["s"]) >= 1.0:
        return None
    passed = np.full(PARTICLES, HORIZON)
    for flight in range(LONGEST_WALK):
        passed = np.where((x["s"] >= 1.0) & (passed == HORIZON), float(flight), passed)
        if (passed < HORIZON).all():
            break
        x = model.apply_process_noise(model.next_state(x, {}, 1.0), 1.0)
    return np.quantile(passed, SHARES, method="inverted_cdf")


def _crack_law() -> Any:
    """Return the model, a class: progpy is needed only here."""
    from progpy import PrognosticsModel

    class CrackLaw(PrognosticsModel):  # type: ignore[misc]
        """Growth ds/dn = c s^m of P. Paris and F. Erdogan, J. Basic Eng. 85 (1963) 528."""

        is_vectorized = True
        inputs: ClassVar[list[str]] = []
        states: ClassVar[list[str]] = ["s", "log_c", "m"]
        outputs: ClassVar[list[str]] = ["s"]
        events: ClassVar[list[str]] = ["passed"]
        default_parameters: ClassVar[dict[str, Any]] = {
            "x0": {"s": 0.1, "log_c": -3.0, "m": 1.0}}

        def next_state(self, x: Any, _u: Any, dt: float) -> Any:
            m = np.clip(x["m"], 0.0, 4.0)
            step = np.exp(np.minimum(x["log_c"] + m * np.log(np.clip(x["s"], 1e-6, 2.0)), 1.0))
            return self.StateContainer(np.stack([x["s"] + dt * step, x["log_c"], m]))

        def output(self, x: Any) -> Any:
            return self.OutputContainer({"s": x["s"]})

    return CrackLaw


FORECASTERS: dict[str, Forecaster] = {
    "ema trend": of_the_trend, "median slope": median_slope, "Bayesian line": bayesian_line,
    "particle filter": particle_filter,
}
