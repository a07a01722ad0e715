"""What is ahead of an actuator: cone, dates, limits of one's own, in pictures and words."""

from dataclasses import replace
from datetime import date

import numpy as np
import pytest

from ema_cli.commands.trend import exit_status, growth_lines, parse_limit
from ema_cli.views.flights_plot import trend_figure
from ema_cli.views.rig_trend import RigTrend, rig_trend, trend_lines
from ema_prognostics.trend.flights import date_of, in_order
from ema_prognostics.trend.forecast import course
from ema_prognostics.trend.unit_trend import trend_of
from ema_prognostics.trend.values import value_trend
from ema_record.errors import UsageError
from support.flights import flights_of

DAY = 86_400 * 10**9
BEGIN = 1_790_000_000 * 10**9


def growing(count=10, rate=0.004):
    flights = flights_of([0.02 + rate * n for n in range(count)])
    return [replace(f, start_time=BEGIN + 2 * DAY * n) for n, f in enumerate(flights)]


@pytest.mark.parametrize(("text", "expected"), [
    ("turn_short=5%", 0.05), ("turn_short = 0.05", 0.05), ("friction=80 %", 0.8),
    ("backlash=2mrad", 0.002), ("backlash=0.002 rad", 0.002),
])
def test_limits(text, expected):
    name, severity = parse_limit(text)
    assert name == text.partition("=")[0].strip()
    assert severity == pytest.approx(expected)


@pytest.mark.parametrize(("text", "problem"), [
    ("turnshort=5%", "did you mean 'turn_short'"), ("turn_short=5mrad", "is no unit"),
    ("turn_short", "is not a number"), ("backlash=-1", "out of bounds"),
    ("backlash=2%", "no unit"), ("turn_short=5", r"out of bounds: give 1e-06 to 1 \(5% is 0.05\)"),
    ("backlash=2", r"out of bounds: give 1e-06 to 0.1 \(5 mrad is 0.005\)"),
    ("turn_short=200%", "out of bounds: give 1e-06 to 100$"),
])
def test_limits_that_are_none(text, problem):
    with pytest.raises(UsageError, match=problem):
        parse_limit(text)


@pytest.mark.parametrize("text", ["a.b=1e999", "a.b=-1e999%", "a.b=nan", "a.b"])
def test_a_limit_of_a_rig_is_a_number(text):
    with pytest.raises(UsageError, match=r"write NAME=VALUE or NAME=\+P%"):
        rig_trend([], map_file=None, model=None, limits=[text])


@pytest.mark.parametrize(("ends_unread", "status"), [(False, 0), (True, 3)])
def test_a_rig_whose_last_record_gives_nothing_is_not_known_to_be_well(ends_unread, status):
    steady = value_trend("a", "N", dict.fromkeys((1, 3, 4), (1.0, 0.9, 1.1)), None)
    found = RigTrend(axis="x", sources=tuple("abcde"), unread={2: "too short"}, values=(steady,),
                     ordered_by="name", ends_unread=ends_unread)
    assert found.exit_status == status


def test_of_many_left_out_records_the_last_are_told():
    found = RigTrend(axis="x", sources=tuple(map(str, range(40))), ordered_by="name", values=(),
                     unread=dict.fromkeys(range(1, 31), "too short"))
    lines = trend_lines(found)
    assert lines[1] == "  record 19 left out: too short"
    assert lines[-1] == "  and 18 records before"


@pytest.mark.parametrize(("marks", "status"), [
    ([".", ".", "."], 0), ([".", 0.1, 0.1], 1), ([0.1, 0.1, ".", ".", "."], 0),
    ([".", ".", 0.1], 3), ([0.1, ".", "."], 3), ([0.1, ".", ".", "."], 0),
    ([".", "?", "."], 0), ([".", "?"], 3), ([".", "x", "."], 0), ([".", "x"], 3),
    (["x", "x"], 2), ([0.1, 0.1, "?"], 1),
])
def test_the_exit_status_is_that_of_the_unit_at_the_end(marks, status):
    """A fault that is announced and not confirmed, or a last test without an answer, is doubt."""
    assert exit_status(trend_of("SN-1", flights_of(marks))) == status


def test_growth_that_no_flight_announces_is_doubt():
    rising = flights_of(["."] * 40, np.linspace(0.01, 0.3, 40))
    assert exit_status(trend_of("SN-1", rising)) == 3


def test_flights_of_unknown_units_do_not_clear_each_other():
    assert exit_status(trend_of("", flights_of([".", "?", "."]))) == 3
    assert exit_status(trend_of("", flights_of([".", ".", "."]))) == 0


def test_a_copy_at_the_end_is_no_test_without_an_answer():
    last = flights_of([".", "."])[-1]
    copy = replace(last, verdict=replace(last.verdict, bag="flight_2_copy"))
    assert exit_status(trend_of("SN-1", in_order([*flights_of([".", "."]), copy]))) == 0


def test_dates_go_on_at_the_pace_of_the_flights():
    flights = growing()
    assert date_of(flights, 1).date() == date(2026, 9, 21)
    assert (date_of(flights, 20) - date_of(flights, 10)).days == 20
    assert date_of([replace(f, start_time=0) for f in flights], 5) is None
    assert date_of(flights, 10**9) is None


def test_the_cone_meets_a_level_where_the_forecast_says():
    (fault,) = trend_of("SN-1", growing()).faults
    ahead, steps = fault.forecasts[-1], np.arange(0.0, 60.0, 0.1)
    middle, low, high = course(fault.outlook, steps)
    reached = [10 + steps[np.argmax(part >= ahead.severity)] for part in (high, middle, low)]
    assert reached[1] == pytest.approx(ahead.flight, abs=2.0)  # whole flights, rounded up
    assert (reached[0], reached[2]) == pytest.approx(ahead.interval, abs=2.0)


def test_the_figure_goes_on_to_the_levels_with_dates():
    trend = trend_of("SN-1", growing(), limits={"turn_short": 0.09})
    figure = trend_figure(trend)
    panel, strip = figure.axes[:2]
    assert panel.get_xlim()[1] >= max(f.flight for f in trend.faults[0].forecasts)
    said = {text.get_text() for text in panel.texts}
    assert {"own limit", "large"} <= said
    assert any(text.startswith(f"{trend.faults[0].forecasts[-1].flight} (") for text in said)
    figure.draw_without_rendering()
    ticks = [t.get_text() for t in strip.get_xticklabels()]
    assert any("\n2026-" in t for t in ticks) and any("\n~2026-" in t for t in ticks)


def test_words_tell_the_day_and_the_limit():
    limits = {"turn_short": 0.03}
    flights = growing()
    (fault,) = trend_of("SN-1", flights, limits=limits).faults
    first, *ahead = growth_lines(fault, flights, limits)
    assert "your limit of 3 % of the turns is reached" in first
    assert ", about 2026-1" in ahead[-1] and "in 2" in ahead[-1]
