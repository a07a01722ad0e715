"""Values of an axis over records: closed forms, and how often chance is called a change."""

import json

import numpy as np
import pytest
from scipy.stats import binom

from ema_prognostics.trend.values import value_trend


def of(y, half=0.01, limit=None):
    return value_trend("friction", "N", {k: (v, v - half, v + half)
                                         for k, v in enumerate(y, start=1)}, limit)


def test_a_line_has_its_slope_either_way_and_reaches_its_limit():
    up, down = of(1.0 + 0.1 * np.arange(12), limit=3.1), of(5.0 - 0.1 * np.arange(12), limit=3.5)
    assert (up.way, up.growth.rate, up.now) == (1, pytest.approx(0.1), pytest.approx(2.1))
    assert (down.way, down.growth.rate, down.now) == (-1, pytest.approx(0.1), pytest.approx(3.9))
    assert up.steps == () and down.steps == ()
    assert up.limit.record == pytest.approx(12 + 10, abs=1)
    assert down.limit.record == pytest.approx(12 + 4, abs=1)
    assert up.limit.interval[0] <= up.limit.record <= up.limit.interval[1]
    rate = json.loads(json.dumps(down.to_dict()))["growth"]
    assert rate["rate"] == pytest.approx(-0.1)
    assert rate["interval"][0] <= -0.1 + 1e-9 and rate["interval"][1] >= -0.1 - 1e-9


def test_a_step_is_found_where_it_is_and_growth_counts_from_there():
    rng = np.random.default_rng(5)
    y = np.r_[np.full(8, 2.0), 3.0 + 0.05 * np.arange(9)] + 0.002 * rng.standard_normal(17)
    found = of(y)
    assert [step.record for step in found.steps] == [9]
    assert found.growth.count == 9
    assert found.growth.rate == pytest.approx(0.05, rel=0.1)


def test_the_interval_of_a_step_is_that_of_students_t():
    y = np.r_[[1.0, 1.1, 0.9, 1.0], [2.0, 2.1, 1.9, 2.0]]
    (step,) = of(y, half=0.1).steps
    error = np.sqrt((0.02 + 0.02) / 6 * (1 / 4 + 1 / 4))  # by hand
    wide = 1.9432 * error  # t of 6 degrees of freedom at 95 %
    assert (step.before, step.after) == pytest.approx((1.0, 2.0))
    assert step.interval == pytest.approx((1.0 - wide, 1.0 + wide), rel=1e-4)


def test_a_limit_is_passed_on_the_side_that_it_lies():
    assert of(1.0 + 0.1 * np.arange(12), limit=2.0).limit.passed
    assert of(5.0 - 0.1 * np.arange(12), limit=4.0).limit.passed
    steady = of([1.0, 1.01, 0.99, 1.0, 1.01, 0.99, 1.0], limit=2.0)
    assert (steady.limit.passed, steady.limit.interval, steady.moves) == (False, None, False)


@pytest.mark.parametrize(("values", "limit", "passed"), [
    ([4.0, 4.0, 4.0, 8.0, 8.0], 6.0, True), ([8.0, 8.0, 8.0, 4.0, 4.0], 6.0, True),
    ([4.0, 4.0, 4.0, 4.0, 8.0], 6.0, False), ([4.0, 4.0, 4.0, 8.0, 4.0], 6.0, False),
    ([4.0, 4.0, 4.0, 6.01, 6.01], 6.0, False),
])
def test_two_records_that_are_surely_beyond_a_limit_pass_it(values, limit, passed):
    """Though the median of the last five is not there yet; one may be by chance."""
    assert of(values, half=0.05, limit=limit).limit.passed == passed


def test_a_change_below_the_error_of_one_record_is_no_step():
    y = np.r_[np.full(8, 1.0), np.full(8, 1.001)]
    assert of(y, half=0.05).steps == ()


def test_few_records_give_a_value_and_no_rate():
    found = of([1.0, 2.0])
    assert (found.growth, found.way, found.steps, found.now) == (None, 0, (), 1.5)
    assert found.to_dict()["growth"] is None


@pytest.mark.parametrize("noise", ["normal", pytest.param("heavy", marks=pytest.mark.slow)])
def test_chance_is_called_a_change_no_more_often_than_it_says(noise):
    rng = np.random.default_rng(91_007)
    count = 400
    draw = rng.standard_normal if noise == "normal" else lambda n: rng.standard_t(4, n)
    found = [of(1.0 + 0.02 * draw(15), half=0.03) for _ in range(count)]
    most = binom.ppf(0.999, count, 0.01)  # two sides of a half per cent
    assert sum(f.way != 0 for f in found) <= most
    assert sum(bool(f.steps) for f in found) <= most
