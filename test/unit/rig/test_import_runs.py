"""Several runs in one file, decimal commas that are found, and everyday units."""

import numpy as np
import pytest

from ema_record.errors import InvalidRecordError, UsageError
from ema_rig.import_file import import_file
from ema_rig.map import map_from
from ema_rig.units import unit_factor

MAP = {"name": "bench", "axis": "rotary", "time": {"column": "t", "unit": "s"},
       "input": {"column": "u", "unit": "V"}, "position": {"column": "q", "unit": "rad"}}
STEP = 0.01


def runs(count=3, length=50, first=0.0):
    """Return rows of run, t, u, q; each run begins at the same time."""
    t = first + STEP * np.arange(length)
    return np.vstack([np.column_stack([np.full(length, 10 + k), t, np.sin(t + k), t * (k + 1)])
                      for k in range(count)])


def written(path, rows, decimal=".", delimiter=","):
    body = "\n".join(delimiter.join(f"{x:.9g}" for x in row) for row in rows) + "\n"
    path.write_text(delimiter.join(["run", "t", "u", "q"]) + "\n" + body.replace(".", decimal))
    return path


def imported(path, **more):
    return import_file(path, map_from({**MAP, **more}, "map"))


@pytest.mark.parametrize("more", [{}, {"run": {"column": "run"}}])
@pytest.mark.parametrize("first", [0.0, 100.0])
def test_runs_follow_one_another_with_a_gap(tmp_path, more, first):
    rows = runs(first=first)
    record = imported(written(tmp_path / "a.csv", rows), **more)
    expected = np.concatenate([first + k * (1.0 + 49 * STEP) + STEP * np.arange(50)
                               for k in range(3)])
    np.testing.assert_allclose(record.time, expected)
    np.testing.assert_allclose(record.channel("position"), rows[:, 3], atol=1e-8)
    assert "3 runs, put one after the other with 1 s between" in record.axis.notes


def test_some_runs_are_chosen_by_number(tmp_path):
    path = written(tmp_path / "a.csv", runs())
    record = imported(path, run={"column": "run", "only": [12, 10]})
    np.testing.assert_allclose(
        record.channel("position"), np.delete(runs(), np.s_[50:100], axis=0)[:, 3], atol=1e-8)
    with pytest.raises(UsageError, match="no run 13; the file has 10, 11, 12"):
        imported(path, run={"column": "run", "only": [13]})


def test_runs_keep_their_own_part_of_the_time(tmp_path):
    record = imported(written(tmp_path / "a.csv", runs()), start=0.1, end=0.295)
    assert len(record.time) == 3 * 20
    assert (np.diff(record.time) > 1.0).sum() == 0
    np.testing.assert_allclose(np.sort(np.diff(record.time))[-2:], 1.0)


def test_a_time_that_only_steps_back_is_no_run(tmp_path):
    rows = runs(count=1, length=200)
    rows[120:, 1] -= 0.5
    with pytest.raises(InvalidRecordError, match="increase"):
        imported(written(tmp_path / "a.csv", rows))


def test_too_many_runs_are_refused(tmp_path):
    rows = runs(count=1, length=3000)
    rows[:, 0] = np.arange(3000) % 2
    with pytest.raises(UsageError, match="3000 runs, at most 1000"):
        imported(written(tmp_path / "a.csv", rows), run={"column": "run"})


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_a_decimal_comma_is_found(tmp_path, delimiter):
    rows = runs(count=1)
    record = imported(written(tmp_path / "a.csv", rows, ",", delimiter))
    np.testing.assert_allclose(record.samples, rows[:, 1:], atol=1e-8)


def test_whole_numbers_between_commas_are_no_decimals(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("run,t,u,q\n" + "\n".join(f"1,{k},{k % 7},{2 * k}" for k in range(60)))
    np.testing.assert_array_equal(imported(path).channel("position"), 2.0 * np.arange(60))


@pytest.mark.parametrize(("unit", "quantity", "factor"), [
    ("km/h", "linear speed", 1.0 / 3.6), ("mph", "linear speed", 1609.344 / 3600.0),
    ("ft/s", "linear speed", 12 * 0.0254), ("1/min", "angular speed", 2 * np.pi / 60),
    ("kgf", "force", 9.80665), ("lbf ft", "torque", 4.4482216152605 * 0.3048),
    ("ozf in", "torque", 4.4482216152605 / 16 * 0.0254), ("h", "time", 3600.0),
    ("us", "time", 1e-6), ("min", "time", 60.0), ("cm", "length", 0.01), ("in", "length", 0.0254),
    ("ft", "length", 0.3048), ("deg", "angle", np.pi / 180.0), ("rev", "angle", 2.0 * np.pi),
    ("mrad", "angle", 1e-3), ("mm/s", "linear speed", 1e-3),
    ("mm/min", "linear speed", 1e-3 / 60.0), ("m/min", "linear speed", 1.0 / 60.0),
    ("deg/s", "angular speed", np.pi / 180.0), ("rev/s", "angular speed", 2.0 * np.pi),
    ("krpm", "angular speed", 2e3 * np.pi / 60.0), ("kV", "voltage", 1e3), ("mA", "current", 1e-3),
    ("lbf", "force", 0.45359237 * 9.80665), ("kN", "force", 1e3), ("N cm", "torque", 0.01),
    ("mNm", "torque", 1e-3), ("lbf in", "torque", 4.4482216152605 * 0.0254),
])
def test_units_by_their_definitions(unit, quantity, factor):
    assert unit_factor(unit, quantity, "map") == pytest.approx(factor, rel=1e-9)


def test_a_file_without_a_time_is_sampled_at_the_rate_of_its_map(tmp_path):
    record = imported(written(tmp_path / "a.csv", runs(count=1)), time={"rate": 250.0})
    np.testing.assert_allclose(record.time, np.arange(50) / 250.0)


def test_a_twentieth_of_the_rows_may_lack_a_value_and_no_more(tmp_path):
    for lost in (3, 4):
        rows = runs(count=1, length=60)
        rows[10:10 + lost, 3] = np.nan
        path = written(tmp_path / f"{lost}.csv", rows)
        if lost == 3:
            assert len(imported(path)) == 57
        else:
            with pytest.raises(InvalidRecordError, match="4 of 60 rows lack a value"):
                imported(path)


def clocked(path, *words, unit):
    path.write_text("t,u,q\n" + "\n".join(f"{word},{k},{k}.5" for k, word in enumerate(words)))
    return imported(path, time={"column": "t", "unit": unit})


def test_dates_of_other_zones_are_the_same_moments(tmp_path):
    """As the clocks of people go back in autumn, a file goes on."""
    record = clocked(tmp_path / "a.csv", "2024-10-27T02:59:59+02:00", "2024-10-27T02:00:00+01:00",
                     "2024-10-26T21:30:01-03:30", "2024-10-27T01:00:02Z", unit="iso")
    np.testing.assert_allclose(record.time, np.arange(4.0))


def test_a_clock_goes_on_past_midnight_and_steps_back_nowhere_else(tmp_path):
    record = clocked(tmp_path / "a.csv", "23:59:58", "23:59:59", "0:00:00", "0:00:01",
                     unit="h:m:s")
    np.testing.assert_allclose(np.diff(record.time), 1.0)
    with pytest.raises(InvalidRecordError, match="does not increase"):
        clocked(tmp_path / "b.csv", "10:00:02", "10:00:03", "10:00:02.5", "10:00:04", unit="h:m:s")


def test_a_test_of_the_actuator_counts_from_its_command_and_is_alone(tmp_path):
    t = 0.0005 * np.arange(1000)

    def tested(first, each=t, **more):
        np.savez(tmp_path / "a.npz", t=first + each, w=np.sin(50 * each))
        parts = {f"phase_current_{k}": {"column": "w", "unit": "A"} for k in "ab"}
        return import_file(tmp_path / "a.npz", map_from({
            "name": "ours", "axis": "actuator", "profile": "step", "time": {"column": "t"},
            "channels": {"motor_speed": {"column": "w", "unit": "rpm"}, **parts}, **more}, "map"))

    for first in (1.7e9, -0.1):
        with pytest.raises(UsageError, match=r"times begin at .* set time\.zero"):
            tested(first)
    zero = {"column": "t", "zero": 1.7e9 + 0.1}
    record = tested(1.7e9, start=0.0, time=zero)
    np.testing.assert_allclose(record.time, t[:800], atol=1e-6)
    with pytest.raises(UsageError, match="2 runs, a record holds one test"):
        tested(0.0, np.concatenate([t, t]))
