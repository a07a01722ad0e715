"""Rate and forecast, against closed forms and against processes of known growth."""

import math

import numpy as np
import pytest
from scipy.stats import invgauss

from ema_prognostics.trend.growth import (
    HORIZON,
    MIN_FLIGHTS,
    Growth,
    forecast,
    growth,
    passage_probability,
)


def of(y, half=0.0, x=None):
    y = np.asarray(y, dtype=float)
    x = np.arange(1, len(y) + 1) if x is None else np.asarray(x)
    return growth(x, y, y - half, y + half)


def test_a_line_has_its_slope_and_the_rank_test_its_exact_probability():
    found = of(0.01 + 0.002 * np.arange(8))
    assert found.rate == pytest.approx(0.002, rel=1e-12)
    assert found.rate_interval == pytest.approx((0.002, 0.002), rel=1e-9)
    assert found.p_value == pytest.approx(1 / math.factorial(8))
    assert found.severity == pytest.approx(0.024)
    assert found.growing
    assert found.wander == pytest.approx(0.0, abs=1e-20)


def test_missing_flights_do_not_matter():
    x = np.array([2, 3, 7, 8, 20, 21])
    assert of(0.002 * x, x=x).rate == pytest.approx(0.002, rel=1e-12)


def test_outliers_do_not_move_the_rate():
    y = 0.002 * np.arange(20.0)
    y[[4, 9, 15]] = 0.5
    assert of(y).rate == pytest.approx(0.002, rel=0.05)


def test_too_few_flights():
    assert of(np.arange(MIN_FLIGHTS - 1.0)) is None
    assert of(np.arange(float(MIN_FLIGHTS))) is not None


def test_a_constant_does_not_grow():
    found = of(np.full(10, 0.05))
    assert (found.rate, found.p_value, found.growing) == (0.0, 1.0, False)
    assert forecast(found, 0.1) is None


def test_scatter_is_called_growth_no_more_often_than_the_test_says():
    rng = np.random.default_rng(91_001)
    count = 400
    growing = sum(of(0.05 + 0.005 * rng.normal(size=15), 0.008).growing for _ in range(count))
    assert growing <= 0.05 * count + 2.0 * math.sqrt(0.05 * 0.95 * count)


def test_falling_is_no_growth():
    found = of(0.1 - 0.002 * np.arange(10))
    assert found.rate < 0.0
    assert not found.growing


@pytest.mark.parametrize("t", [5.0, 20.0, 60.0])
def test_first_passage_is_the_inverse_gaussian(t):
    distance, drift, wander = 0.04, 0.002, 3e-5
    mean, shape = distance / drift, distance**2 / wander
    expected = invgauss.cdf(t, mean / shape, scale=shape)
    assert passage_probability(t, distance, drift, wander) == pytest.approx(expected, rel=1e-9)


def test_a_process_that_drifts_away_may_never_pass():
    """P(ever) = exp(2 μ a / σ²) for a drift μ < 0."""
    distance, drift, wander = 0.02, -0.001, 1e-4
    ever = math.exp(2.0 * drift * distance / wander)
    assert passage_probability(1e9, distance, drift, wander) == pytest.approx(ever, rel=1e-6)


def test_steady_growth_is_forecast_without_doubt():
    found = of(0.01 + 0.002 * np.arange(20))
    coming = forecast(found, 0.148)
    assert (coming.lower, coming.median, coming.upper) == pytest.approx((50.0,) * 3, rel=0.02)


def test_a_level_that_is_reached_is_not_forecast():
    assert forecast(of(0.01 + 0.002 * np.arange(20)), 0.03) is None


def test_slow_growth_has_no_end_in_sight():
    found = Growth(count=30, rate=1e-6, rate_interval=(1e-8, 2e-6), p_value=0.01, growing=True,
                   severity=0.01, severity_error=1e-3, wander=1e-9)
    coming = forecast(found, 0.5)
    assert (coming.lower, coming.median, coming.upper) == (HORIZON, None, None)


def test_the_forecast_covers_irregular_growth():
    """Wiener processes with drift, seen with scatter: the 90 % interval holds the passage."""
    rng = np.random.default_rng(91_002)
    drift, wander, sigma, level = 0.002, 6e-6, 0.0015, 0.10
    covered = total = 0
    for _ in range(150):
        path = np.cumsum(drift + math.sqrt(wander) * rng.normal(size=400))
        if path[:25].max() > 0.9 * level or path.max() < level:
            continue
        passed = int(np.argmax(path >= level)) - 24
        seen = of(path[:25] + sigma * rng.normal(size=25), 1.645 * sigma)
        coming = forecast(seen, level)
        if coming is None:
            continue
        total += 1
        upper = math.inf if coming.upper is None else math.ceil(coming.upper)
        covered += math.floor(coming.lower) <= passed <= upper
    assert total > 100
    assert 0.80 <= covered / total <= 0.99
