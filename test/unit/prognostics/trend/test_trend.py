"""`trend_of`: growth since the last repair, forecast of the next level, plain data."""

import json

import pytest

from ema_prognostics.cascade.classes import LEVELS
from ema_prognostics.trend.unit_trend import trend_of
from support.flights import flights_of

MEDIUM, LARGE = LEVELS["turn_short"]


def test_growth_and_the_levels_ahead():
    rate = 0.002
    marks = [".", ".", *[0.01 + rate * n for n in range(12)]]
    (fault,) = trend_of("SN-1", flights_of(marks)).faults
    assert (fault.announced, fault.confirmed, fault.present) == (3, 4, True)
    assert fault.growth.rate == pytest.approx(rate)
    ahead = {f.level: f for f in fault.forecasts}
    assert list(ahead) == ["medium", "large"]
    for level, severity in (("medium", MEDIUM), ("large", LARGE)):
        flight = 14 + (severity - marks[-1]) / rate
        assert ahead[level].flight == pytest.approx(flight, abs=1.5)
        first, last = ahead[level].interval
        assert first <= ahead[level].flight <= last


def test_a_limit_of_ones_own_is_forecast_between_the_levels():
    marks = [0.01 + 0.002 * n for n in range(12)]
    (fault,) = trend_of("SN-1", flights_of(marks), limits={"turn_short": 0.1}).faults
    assert [f.level for f in fault.forecasts] == ["medium", "limit", "large"]
    assert fault.forecasts[1].flight == pytest.approx(12 + (0.1 - marks[-1]) / 0.002, abs=1.5)
    (fault,) = trend_of("SN-1", flights_of(marks), limits={"turn_short": 0.02}).faults
    assert [f.level for f in fault.forecasts] == ["medium", "large"]  # it is reached


def test_growth_begins_anew_after_a_repair():
    marks = [*[0.02 * n for n in range(1, 8)], *["."] * 4, *[0.01 + 0.001 * n for n in range(6)]]
    (fault,) = trend_of("SN-1", flights_of(marks)).faults
    assert [(e.confirmed, e.cleared, e.repaired) for e in fault.episodes] == [
        (2, 8, True), (13, None, False),
    ]
    assert fault.falls == ()  # the repair is told once
    assert fault.growth.count == 6
    assert fault.growth.rate == pytest.approx(0.001)


def test_growth_begins_anew_after_a_fall():
    marks = [*[0.1 + 0.01 * n for n in range(6)], *[0.01 + 0.001 * n for n in range(6)]]
    (fault,) = trend_of("SN-1", flights_of(marks)).faults
    assert fault.falls == (7,)
    assert fault.growth.rate == pytest.approx(0.001)


def test_flights_without_an_answer_are_listed_and_are_not_healthy():
    marks = [0.1, 0.1, "?", "x", "?", "x", "."]
    found = trend_of("SN-1", flights_of(marks))
    assert found.unanswered == (3, 4, 5, 6)
    assert found.faults[0].present  # one flight without it is no repair
    assert trend_of("SN-1", flights_of(["x", "?"])).faults == ()


def test_gone_faults_are_not_present():
    (fault,) = trend_of("SN-1", flights_of([0.1, 0.1, ".", ".", "."])).faults
    assert not fault.present
    assert fault.growth is None


def test_json():
    found = trend_of("SN-1", flights_of([".", *[0.01 * n for n in range(1, 9)], "?"]))
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert (data["serial_number"], data["flights"], data["unanswered"]) == ("SN-1", 10, [10])
    (fault,) = data["faults"]
    assert (fault["fault_class"], fault["phase"], fault["announced"]) == ("turn_short", "b", 2)
    assert fault["growth"]["growing"] is True
    assert [f["level"] for f in fault["forecasts"]] == ["large"]
