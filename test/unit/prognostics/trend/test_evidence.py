"""The sequential test: distribution-free scores, run length, growth below announcement."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtri

from ema_prognostics.trend.evidence import (
    ALLOWANCE,
    LIMIT,
    cumulative_sum,
    sequential_scores,
    suspicion,
)
from ema_prognostics.trend.flights import in_order
from ema_prognostics.trend.unit_trend import trend_of
from support.flights import flights_of


def run_length(allowance: float, limit: float) -> float:
    """Return the mean number of independent standard normal scores to a false alarm."""
    b = limit + 1.166
    return float((np.exp(2.0 * allowance * b) - 2.0 * allowance * b - 1.0) / (2 * allowance**2))


def test_scores_are_ranks_among_those_so_far():
    found = sequential_scores(np.array([5.0, 7.0, 6.0, 6.0, 1.0]))
    places = [0.5, 1.5 / 2, 1.5 / 3, 2.0 / 4, 0.5 / 5]  # equal values share a rank
    assert found == pytest.approx(ndtri(places))


def test_scores_do_not_depend_on_the_distribution():
    values = np.random.default_rng(91_010).normal(size=50)
    assert (sequential_scores(values) == sequential_scores(np.exp(9.0 * values))).all()


def test_sum_after_page():
    assert cumulative_sum(np.array([1.0, 1.0, -3.0, 2.0])).tolist() == [0.5, 1.0, 0.0, 1.5]


def test_run_length_of_the_limit():
    assert run_length(ALLOWANCE, LIMIT) == pytest.approx(2000, rel=0.01)


def test_run_length_by_simulation():
    rng = np.random.default_rng(91_011)
    lengths = []
    for _ in range(1500):
        above = np.flatnonzero(cumulative_sum(rng.normal(size=1200)) > 3.0)
        lengths.append(above[0] + 1 if len(above) else 1200)
    assert np.mean(lengths) == pytest.approx(run_length(ALLOWANCE, 3.0), rel=0.1)


def test_false_suspicions_of_any_distribution():
    """600 units of 60 flights: about 60 / 2,000 of them raise one, whatever is ranked."""
    rng = np.random.default_rng(91_012)
    raised = 0
    for _ in range(600):
        raised += bool((cumulative_sum(sequential_scores(rng.exponential(size=60))) > LIMIT).any())
    assert raised <= 600 * 60 / 2000 + 3.0 * np.sqrt(18.0)


def test_growth_that_no_flight_announces_is_suspected():
    rng = np.random.default_rng(91_013)
    odds = np.exp(-5.0 + 0.3 * rng.normal(size=40) + 0.06 * np.maximum(np.arange(40) - 10, 0))
    flights = flights_of(["."] * 40, odds / (1.0 + odds))
    found = trend_of("SN-1", flights)
    assert found.faults == ()
    assert 12 < found.suspected["turn_short"] <= 40


def test_no_probability_no_evidence():
    assert suspicion(flights_of(["?", "x"] * 20), "turn_short") is None
    assert suspicion(flights_of(["."] * 40), "backlash") is None


def test_what_was_announced_first_is_not_suspected_later():
    flights = flights_of([*["."] * 5, *[0.1] * 10], np.linspace(0.01, 0.02, 15))
    found = trend_of("SN-1", flights)
    assert found.faults[0].announced == 6
    assert found.suspected == {}


def test_a_suspicion_ends_with_what_spoke_for_it():
    """A false one does not stay for ever: quiet flights take the sum back to zero."""
    rng = np.random.default_rng(91_014)
    odds = 0.01 * np.exp(0.1 * rng.normal(size=160))
    odds[20:32] *= 3.0
    flights = flights_of(["."] * 160, odds)
    assert suspicion(flights[:32], "turn_short") is not None
    assert suspicion(flights, "turn_short") is None


def test_another_test_is_no_growth():
    """Probabilities of step and extended are of different levels: ranks are of each alone."""
    rng = np.random.default_rng(91_015)
    odds = 0.01 * np.exp(0.1 * rng.normal(size=40))
    odds[12:28] *= 5.0
    names = ["extended"] * 12 + ["step"] * 16 + ["extended"] * 12
    flights = [replace(f, profile=n) for f, n in zip(flights_of(["."] * 40, odds), names)]
    assert suspicion(flights, "turn_short") is None


def test_copies_are_no_flights_of_growth():
    """Each flight once more: the same rate, the same forecast."""
    marks = [0.01 * n for n in range(1, 13)]
    alone = trend_of("SN-1", flights_of(marks)).faults[0]
    twice = [replace(f, verdict=replace(f.verdict, bag=f"{f.verdict.bag}{end}"))
             for f in flights_of(marks) for end in ("", "_recovered")]
    found = trend_of("SN-1", in_order(twice)).faults[0]
    assert found.growth == alone.growth
    assert found.forecasts == alone.forecasts
