"""The forecast, against closed forms and against growth that is known."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from ema_prognostics.trend.forecast import HORIZON, Outlook, forecast, outlook, passage_law
from ema_prognostics.trend.growth import growth


def ahead(y, level, half=0.0, x=None):
    y = np.asarray(y, dtype=float)
    x = np.arange(1, len(y) + 1) if x is None else np.asarray(x)
    seen = (x, y, y - half, y + half)
    view = outlook(*seen, growth(*seen))
    return None if view is None else forecast(view, level)


def known(*, severity=0.02, rate=0.002, acceleration=0.0, steadily=False, memory=1.0,
          variance=0.0, rate_error=0.0, shared=0.0):
    """Return an outlook of one process, known but for the error of its rate."""
    covariance = np.zeros((3, 3, 1))
    covariance[0, 0], covariance[1, 1], covariance[2, 2] = 1e-16, rate_error**2, variance
    return Outlook(
        weight=np.ones(1), acceleration=np.array([acceleration]),
        steadily=np.array([steadily]), pace=np.ones(1), memory=np.array([memory]),
        variance=np.array([variance]),
        mean=np.array([[severity], [rate], [0.0]]), covariance=covariance, severity=severity,
        shared=shared,
    )


def test_steady_growth_is_forecast_without_doubt():
    coming = ahead(0.01 + 0.002 * np.arange(20), 0.148)
    assert (coming.lower, coming.median, coming.upper) == pytest.approx((50.0,) * 3, rel=0.02)


@pytest.mark.parametrize("doubling", [8.0, 15.0])
def test_exponential_growth_is_forecast_in_time(doubling):
    """A severity 2^(n/d) grows by the factor f in d log2 f flights; a line says twice that."""
    y = 0.01 * 2.0 ** (np.arange(30) / doubling)
    factor = 2.5
    coming = ahead(y, factor * y[-1], half=0.01 * y[-1])
    left = doubling * math.log2(factor)
    line = (factor - 1.0) * doubling / math.log(2.0)
    assert coming.median == pytest.approx(left, rel=0.1)
    assert coming.lower <= left <= coming.upper < line


def test_an_outlier_and_missing_flights_do_not_move_the_forecast():
    x = np.setdiff1d(np.arange(1, 41), [7, 8, 9, 22])
    y = 0.002 * x
    y[16] += 0.02
    assert ahead(y, 0.18, half=0.003, x=x).median == pytest.approx(50.0, rel=0.05)


def test_a_rate_with_an_error_passes_by_its_normal_law():
    law = passage_law(known(rate_error=0.0004), 0.1)
    for t in (30.0, 40.0, 60.0):
        expected = norm.cdf((0.002 * t - 0.08) / (0.0004 * t))
        assert np.interp(t, law.flights, law.probability) == pytest.approx(expected, abs=0.005)


def test_short_memory_is_a_wiener_process():
    """Its severity at t has the variance 2 m v t for a memory m that is short against t."""
    memory, variance = 0.2, 5e-5
    law = passage_law(known(memory=memory, variance=variance), 0.1)
    for t in (30.0, 40.0, 50.0):
        spread = math.sqrt(2.0 * memory * variance * t)
        expected = norm.cdf((0.002 * t - 0.08) / spread)
        assert np.interp(t, law.flights, law.probability) == pytest.approx(expected, abs=0.02)


def test_a_rate_that_grows_passes_at_the_logarithm():
    """From s with rate r and acceleration g, the way a takes log(1 + g a / r) / g."""
    law = passage_law(known(acceleration=0.05), 0.1)
    assert law.quantile(0.5) == pytest.approx(math.log1p(0.05 * 0.08 / 0.002) / 0.05, rel=0.01)


def test_a_rate_that_grows_steadily_passes_at_the_root():
    """Rate r that grows by g r a flight takes the way w in (sqrt(1 + 2 g w / r) - 1) / g."""
    law = passage_law(known(acceleration=0.05, steadily=True), 0.1)
    root = (math.sqrt(1.0 + 2.0 * 0.05 * 0.08 / 0.002) - 1.0) / 0.05
    assert law.quantile(0.5) == pytest.approx(root, rel=0.01)


def test_growth_with_the_square_of_the_time_is_forecast_in_time():
    """A severity that grows with n² from 0 is four times as large after as many flights more."""
    y = 0.01 + 1e-4 * np.arange(30.0) ** 2
    coming = ahead(y, 0.01 + 4.0 * (y[-1] - 0.01), half=0.002)
    assert coming.median == pytest.approx(29.0, rel=0.1)
    assert coming.lower <= 29.0 <= coming.upper


def test_the_error_that_flights_share_widens_the_interval():
    law = passage_law(known(shared=0.1), 0.1)
    low, high = law.quantile(0.05), law.quantile(0.95)
    assert (low, high) == pytest.approx((40.0 - 1.645 * 5.0, 40.0 + 1.645 * 5.0), rel=0.02)


def test_the_law_never_falls():
    """Degradation does not heal: however the rate wanders, what is passed stays passed."""
    law = passage_law(known(rate=1e-5, memory=20.0, variance=1e-5), 0.03)
    assert (np.diff(law.flights) > 0.0).all()
    assert (np.diff(law.probability) >= 0.0).all()
    assert 0.0 <= law.probability[0] <= law.probability[-1] <= 1.0


def test_a_level_that_is_reached_or_does_not_come_is_not_forecast():
    assert ahead(0.01 + 0.002 * np.arange(20), 0.03) is None
    assert ahead(np.full(10, 0.05) + 0.001 * (-1.0) ** np.arange(10), 0.1) is None


def test_slow_growth_has_no_end_in_sight():
    coming = forecast(known(severity=0.01, rate=1e-6, rate_error=3e-7), 0.5)
    assert (coming.lower, coming.median, coming.upper) == (HORIZON, None, None)


@pytest.mark.slow
def test_the_forecast_covers_growth_that_wanders():
    """Wiener processes with drift, seen with scatter: the 90 % interval holds the passage."""
    rng = np.random.default_rng(91_002)
    drift, wander, sigma, level = 0.002, 6e-6, 0.0015, 0.10
    covered = total = 0
    for _ in range(100):
        path = np.cumsum(drift + math.sqrt(wander) * rng.normal(size=400))
        if path[:25].max() > 0.9 * level or path.max() < level:
            continue
        passed = int(np.argmax(path >= level)) - 24
        coming = ahead(path[:25] + sigma * rng.normal(size=25), level, 1.645 * sigma)
        if coming is None:
            continue
        total += 1
        upper = math.inf if coming.upper is None else math.ceil(coming.upper)
        covered += math.floor(coming.lower) <= passed <= upper
    assert total > 60
    assert 0.80 <= covered / total <= 0.99
