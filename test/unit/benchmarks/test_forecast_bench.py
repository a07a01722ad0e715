"""The bench of the forecast: its courses, its forecasters, and its scores of known forecasts."""

import numpy as np
import pytest
from scipy.stats import invgauss

from benchmarks.forecast.__main__ import PARTS, measure, paired, seen_of
from benchmarks.forecast.courses import LAWS, draw_course
from benchmarks.forecast.peers import (
    Seen,
    bayesian_line,
    median_slope,
    of_the_trend,
    passage_probability,
)

SEED = 91_003


@pytest.mark.parametrize("law", LAWS)
def test_courses_pass_the_level_once_by_their_law(law):
    for number in range(10):
        course = draw_course(law, number, SEED)
        again = draw_course(law, number, SEED)
        assert (course.seen == again.seen).all()
        since = course.severity[course.first:]
        assert (np.diff(since) >= -1e-15).all()
        at = course.passed - course.first
        assert since[at] >= course.level * (1.0 - 1e-9) > since[at - 1]
        steps = np.diff(since[:at])
        if law in ("exponential", "power law"):
            assert (np.diff(steps) > 0.0).all()
        if law == "stalled":
            assert 0.25 * at - 2 <= np.sum(steps < 1e-12) <= 0.5 * at
        if law == "repaired":
            assert course.severity[course.first - 1] > course.severity[course.first]


def test_errors_are_those_that_the_verdicts_state():
    """Of two hundred units, the deviation of all errors is what the table says in all."""
    z = [(c.seen[0] - c.severity[0]) / c.deviation[0]
         for c in (draw_course("linear", 10 * k, SEED) for k in range(200))]
    assert np.std(z) == pytest.approx(np.sqrt(0.47**2 + 0.17**2 + 0.53**2), rel=0.15)


@pytest.mark.parametrize("t", [5.0, 20.0, 60.0])
def test_first_passage_is_the_inverse_gaussian(t):
    distance, drift, wander = 0.04, 0.002, 3e-5
    mean, shape = distance / drift, distance**2 / wander
    expected = invgauss.cdf(t, mean / shape, scale=shape)
    found = passage_probability(np.array(t), distance, np.array(drift), wander)
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("forecaster", [of_the_trend, median_slope, bayesian_line])
def test_a_line_without_scatter_is_forecast_by_all(forecaster):
    x = np.arange(1, 21)
    y = 0.002 * x
    seen = Seen(x, y, y - 1e-6, y + 1e-6, 0.1)
    flights = forecaster(seen, np.random.default_rng(SEED))
    assert np.median(flights) == pytest.approx(30.0, rel=0.01)


def test_growth_that_speeds_up_is_no_longer_forecast_late():
    """Exponential growth at half life: the median slope is late by half at least."""
    ratios = {of_the_trend: [], median_slope: []}
    for number in range(12):
        course = draw_course("exponential", number, SEED)
        now = (course.first + course.passed) // 2
        seen = seen_of(course, now + 1)
        for forecaster, found in ratios.items():
            flights = forecaster(seen, np.random.default_rng(SEED))
            if flights is not None:
                found.append(np.median(flights) / (course.passed - now))
    late, ours = np.median(ratios[median_slope]), np.median(ratios[of_the_trend])
    assert len(ratios[of_the_trend]) >= 9
    assert late > 1.5
    assert 0.8 < ours < 1.25


@pytest.mark.parametrize(("late", "met"), [(1.0, True), (1.15, True), (1.3, False)])
def test_scores_of_forecasts_that_are_known(late, met):
    pytest.importorskip("progpy")
    course = draw_course("linear", 0, SEED)
    life = course.passed - course.first

    def knowing(seen, _rng):
        return np.full(200, late * (course.passed - (seen.number[-1] - 1)))

    score = measure(course, knowing, SEED)
    assert score.alpha_lambda == [met]
    assert score.near == [met]
    left = course.passed - (course.first + round(0.5 * life))
    assert score.accuracy == pytest.approx([2.0 - np.ceil(late * left) / left])
    assert score.horizon == pytest.approx([1.0 - PARTS[0] if met else 0.0], abs=1.0 / life)
    assert np.mean(score.covered) == (1.0 if late == 1.0 else pytest.approx(0.0, abs=0.5))
    assert score.width == [0.0] * len(PARTS)


def test_pairs_count_what_one_alone_meets():
    ours, theirs = [True] * 9 + [False] * 3, [True] * 2 + [False] * 9 + [True]
    only, others, p = paired(ours, theirs)
    assert (only, others) == (7, 1)
    assert p == pytest.approx(2.0 * 9 / 256)
