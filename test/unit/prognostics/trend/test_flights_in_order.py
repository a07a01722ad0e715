"""Flights stand in order, each with its unit."""

from dataclasses import replace
from datetime import datetime, timezone
from time import time_ns

import pytest

from ema_prognostics.trend.flights import Flight, by_unit, date_of, in_order
from ema_prognostics.trend.unit_trend import trend_of
from ema_prognostics.verdict.verdict import Verdict
from support.flights import flights_of, verdict_of

DAY = 86_400 * 10**9
BEGIN = 1_600_000_000 * 10**9


def flight(bag, day=0, unit="SN-1", outcome="healthy"):
    """Return a flight of a day, none: of an unknown one."""
    return Flight(verdict=Verdict(outcome=outcome, bag=bag), serial_number=unit,
                  start_time=BEGIN + day * DAY if day else 0)


def bags(flights):
    return [f.verdict.bag for f in flights]


def test_start_time_first_then_the_name():
    found = in_order([flight("b", 30), flight("a10", 20), flight("a9", 20), flight("z", 10)])
    assert bags(found) == ["z", "a9", "a10", "b"]
    assert [f.number for f in found] == [1, 2, 2, 3]


def test_without_a_time_a_flight_stands_after_its_neighbour_by_name():
    found = in_order([flight("f1", 50), flight("f2"), flight("f3", 40), flight("f4"),
                      flight("f0")])
    assert bags(found) == ["f0", "f3", "f4", "f1", "f2"]


def test_a_copy_is_shown_and_does_not_count():
    found = in_order([flight("a", 7), flight("a_copy", 7), flight("b", 8), flight("c"),
                      flight("d")])
    assert [f.number for f in found] == [1, 1, 2, 3, 4]
    assert [f.repeat_of for f in found] == [None, 1, None, None, None]
    assert [f.answered for f in found] == [True, False, True, True, True]
    assert date_of(found, 6) == datetime.fromtimestamp((BEGIN + 12 * DAY) / 1e9, timezone.utc)


def test_tests_of_one_time_that_say_different_things_are_no_copies():
    """A clock that stands: a fault beside healthy tests counts, and so do these."""
    found = in_order([flight("a", 7), flight("b", 7, outcome="fault"), flight("c", 7),
                      flight("d", 7, outcome="unknown")])
    assert [(f.verdict.bag, f.number, f.repeat_of) for f in found] == [
        ("a", 1, None), ("c", 1, 1), ("b", 2, None), ("d", 3, None)]


@pytest.mark.parametrize("date", ["unknown", "1980", "ahead"])
def test_a_date_that_cannot_be_tells_nothing(date):
    """The newest flights of a clock that lost its battery stay the newest."""
    wrong = {"unknown": 0, "1980": 315_532_800 * 10**9, "ahead": time_ns() + 10 * DAY}[date]
    found = in_order([flight("f1", 1), flight("f2", 2),
                      replace(flight("f3", outcome="fault"), start_time=wrong)])
    assert bags(found) == ["f1", "f2", "f3"]
    assert trend_of("SN-1", found).undated == ((3,) if wrong else ())


@pytest.mark.parametrize("names", [("a", "b"), ("b", "a")])
@pytest.mark.parametrize(("whole", "part"), [
    ("fault", "incomplete"), ("healthy", "incomplete"), ("unknown", "invalid"),
])
def test_of_two_copies_the_one_that_tells_more_counts(names, whole, part):
    found = in_order([flight(names[0], 7, outcome=whole), flight(names[1], 7, outcome=part)])
    (counted,) = [f for f in found if f.repeat_of is None]
    (copy,) = [f for f in found if f.repeat_of is not None]
    assert (counted.verdict.outcome, copy.verdict.outcome) == (whole, part)
    assert copy.repeat_of == counted.number


@pytest.mark.parametrize(
    ("mark", "answers"), [(".", True), (0.1, True), ("?", False), ("x", False)]
)
def test_only_healthy_and_fault_are_answers(mark, answers):
    assert Flight(verdict=verdict_of(mark)).answered is answers


def test_units_are_never_mixed():
    flights = [flight("a", 1, "SN-2"), flight("b", 2, "SN-10"), flight("c", 3, "SN-2"),
               flight("d", 0, "", "invalid")]
    found = by_unit(flights)
    assert {unit: bags(group) for unit, group in found.items()} == {
        "SN-2": ["a", "c"], "SN-10": ["b"], "": ["d"],
    }


def test_an_unreadable_flight_belongs_to_the_only_unit():
    found = by_unit([flight("a", 1), flight("b", 0, "", "invalid"), flight("c", 2)])
    assert {unit: bags(group) for unit, group in found.items()} == {"SN-1": ["a", "b", "c"]}


def test_in_a_fleet_an_unreadable_flight_belongs_to_nobody():
    found = by_unit([flight("a", 1), flight("b", 0, "", "invalid"), flight("c", 2)], one=False)
    assert [len(flights) for flights in found.values()] == [2, 1]
    assert list(found)[1] == ""


def test_the_notation_of_these_tests():
    flights = flights_of([".", 0.1, "?", "x", "."])
    assert [f.number for f in flights] == [1, 2, 3, 4, 5]
    assert bags(flights) == [f"flight_{n}" for n in range(1, 6)]
