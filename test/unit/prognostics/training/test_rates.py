"""Rates with bounds and a90/95: known values and simulated detection."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import expit

from ema_prognostics.training.rates import detection_curve, rate


def test_bounds_of_a_rate() -> None:
    # Clopper and Pearson: 0 of n has the upper bound 1 − 0.025^(1/n).
    found = rate([False] * 50)
    assert (found.hits, found.total, found.lower) == (0, 50, 0.0)
    assert found.upper == pytest.approx(1.0 - 0.025 ** (1 / 50))
    found = rate([True] * 3 + [False] * 7)
    assert (found.lower, found.upper) == pytest.approx((0.0667, 0.6525), abs=1e-3)
    assert rate([True] * 5).upper == 1.0
    assert np.isnan(rate([]).value)


def test_a90_and_its_bound() -> None:
    """The bound lies above the true a90 in about 95 of 100 repetitions."""
    true = np.exp(np.log(0.01) + np.log(9.0) / 4.0)
    rng = np.random.default_rng(4)
    above, a90 = 0, []
    for _ in range(100):
        x = np.exp(rng.uniform(np.log(1e-3), np.log(0.1), 250))
        found = detection_curve(x, rng.random(250) < expit(4.0 * np.log(x / 0.01)))
        assert found is not None
        above += found.a90_95 > true
        a90.append(found.a90)
    assert np.median(a90) == pytest.approx(true, rel=0.05)
    assert 88 <= above <= 100


def test_nothing_can_be_said_where_all_or_none_is_found() -> None:
    x = np.linspace(0.01, 0.1, 50)
    assert detection_curve(x, np.ones(50, dtype=bool)) is None
    assert detection_curve(x, np.zeros(50, dtype=bool)) is None


def test_detection_that_falls_with_severity_has_no_a90() -> None:
    x = np.linspace(0.01, 0.1, 50)
    assert detection_curve(x, x < 0.05) is None


def test_growth_that_multiplies_is_counted_from_one() -> None:
    """What adds to a spread of log 1.1 is the logarithm of 1 + growth."""
    rng = np.random.default_rng(6)
    x = np.exp(rng.uniform(np.log(0.015), 0.0, 4000))
    own = rng.logistic(scale=0.04, size=len(x))
    found = detection_curve(x, np.log1p(x) + own > np.log(1.12), origin=1.0)
    assert found is not None
    assert found.a90 == pytest.approx(1.12 * 9.0**0.04 - 1.0, rel=0.05)


def test_a_curve_that_hardly_rises_has_its_bound_beyond_all_severities() -> None:
    rng = np.random.default_rng(12)
    x = np.exp(rng.uniform(np.log(0.01), 0.0, 40))
    found = detection_curve(x, rng.random(40) < 0.5)
    assert found is not None
    assert 1.0 < found.a90 < found.a90_95 < np.inf
