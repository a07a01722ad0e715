"""Rate and test of growth, against closed forms."""

import math

import numpy as np
import pytest

from ema_prognostics.trend.growth import MIN_FLIGHTS, growth


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


def test_scatter_is_called_growth_no_more_often_than_the_test_says():
    rng = np.random.default_rng(91_001)
    count = 400
    growing = sum(of(0.05 + 0.005 * rng.normal(size=15), 0.008).growing for _ in range(count))
    assert growing <= 0.05 * count + 2.0 * math.sqrt(0.05 * 0.95 * count)


def test_falling_is_no_growth():
    found = of(0.1 - 0.002 * np.arange(10))
    assert found.rate < 0.0
    assert not found.growing
