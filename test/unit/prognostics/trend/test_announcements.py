"""First announcement, confirmation and repair, on sequences that one can check by eye."""

import itertools

import numpy as np
import pytest

from ema_prognostics.trend.announcement import DEFAULT_RULE, episodes, falls, histories, parse_rule
from ema_prognostics.trend.flights import in_order
from ema_record.errors import UsageError
from support.flights import flights_of


def only(marks, rule=DEFAULT_RULE):
    (history,) = histories(flights_of(marks))
    return episodes(history, rule)


@pytest.mark.parametrize(("marks", "first", "confirmed", "last"), [
    ([".", 1, 1], 2, 3, 3),
    ([1, ".", 1], 1, 3, 3),
    ([1, "?", "x", "?", 1], 1, 5, 5),
    ([".", ".", 1], 3, None, 3),
])
def test_two_of_three(marks, first, confirmed, last):
    (episode,) = only(marks)
    assert (episode.first, episode.confirmed, episode.last) == (first, confirmed, last)
    assert episode.cleared is None


def test_a_single_false_announcement_is_not_confirmed():
    first, second = only([1, ".", ".", ".", 1, "."])
    assert (first.confirmed, first.cleared) == (None, 2)
    assert (second.first, second.confirmed, second.cleared) == (5, None, None)


def test_gone_after_three_flights_without_it():
    marks = [1, 1, ".", ".", "?", "."]
    (episode,) = only(marks)
    assert (episode.last, episode.cleared, episode.repaired) == (2, 3, False)
    (episode,) = only(marks[:-1])
    assert episode.cleared is None


def test_gone_though_outgrown_is_a_repair():
    (episode,) = only([0.01, 0.02, 0.04, 0.05, ".", ".", "."])
    assert episode.repaired
    for marks in ([0.01, 0.0099, 0.0101, 0.01], [0.01, 0.05]):  # not grown; too few to say
        (episode,) = only([*marks, ".", ".", "."])
        assert not episode.repaired


def test_back_after_a_repair():
    found = only([1, 1, ".", ".", ".", ".", 1, 1])
    assert [(e.first, e.confirmed, e.cleared) for e in found] == [(1, 2, 3), (7, 8, None)]


@pytest.mark.parametrize("p", [0.01, 0.2, 0.5])
def test_rate_of_false_confirmations(p):
    """Three flights confirm falsely at 3 p² − 2 p³: all eight outcomes counted."""
    total = 0.0
    for pattern in itertools.product((True, False), repeat=3):
        found = histories(flights_of([1 if hit else "." for hit in pattern]))
        confirmed = any(e.confirmed for h in found for e in episodes(h))
        total += confirmed * np.prod([p if hit else 1 - p for hit in pattern])
    assert total == pytest.approx(3 * p**2 - 2 * p**3, rel=1e-12)


@pytest.mark.parametrize(
    ("rule", "confirmed"), [("1/1", 1), ("2/2", 4), ("2/3", 3), ("3/4", 4), ("3/3", 5)]
)
def test_other_rules(rule, confirmed):
    (episode,) = only([1, ".", 1, 1, 1, 1], parse_rule(rule))
    assert episode.confirmed == confirmed


@pytest.mark.parametrize("text", ["", "2", "0/3", "4/3", "a/b", "2/99", "-1/3", "2/3/4"])
def test_no_rule(text):
    with pytest.raises(UsageError, match="K/N"):
        parse_rule(text)


def test_phases_are_faults_of_their_own():
    flights = flights_of([0.1, 0.1, 0.1])
    other = flights[2].verdict.faults[0].__class__(fault_class="turn_short", phase="c",
                                                   severity=0.2)
    verdict = flights[2].verdict
    both = verdict.__class__(outcome="fault", faults=(*verdict.faults, other), bag="flight_3")
    flights = in_order([*flights[:2], flights[2].__class__(
        verdict=both, serial_number="SN-1", start_time=30)])
    found = histories(flights)
    assert [(h.phase, int((h.state == 1).sum())) for h in found] == [("b", 3), ("c", 1)]
    assert found[1].severity[2] == found[1].lower[2] == 0.2  # without an interval


def test_a_fall_is_seen_where_it_happens():
    (history,) = histories(flights_of([0.1, 0.11, 0.12, 0.13, "?", 0.05, 0.05, 0.06, 0.07]))
    assert falls(history) == [6]


def test_growth_and_scatter_are_no_falls():
    (history,) = histories(flights_of([0.1, 0.11, 0.1, 0.12, 0.115, 0.12, 0.13, 0.125]))
    assert falls(history) == []


def test_two_falls():
    (history,) = histories(flights_of([*[0.1] * 4, *[0.05] * 4, *[0.01] * 4]))
    assert falls(history) == [5, 9]
