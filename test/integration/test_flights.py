"""A directory of flights through `ema check` and `ema trend`."""

import csv
import json
import os
import shutil
import subprocess
import sys

import pytest

from ema_cli.main import run
from ema_record.bag.read import write_bag
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate

DAY = 86_400 * 10**9
BEGIN = 1_790_000_000 * 10**9
GROWING = (0.0, 0.06, 0.08, 0.10, 0.12, 0.14)
PNG = b"\x89PNG"


def record_flight(folder, number, severity, unit="SN-7"):
    effects = [] if severity == 0.0 else [f"turn_short.fraction={severity}", "turn_short.phase=b"]
    record = simulate(
        load_profile("extended"), effects=parse_effects(effects), seed=88_000 + number,
        serial_number=unit, start_time=BEGIN + number * DAY,
    )
    return write_bag(record, folder / f"flight_{number}")


@pytest.fixture(scope="module")
def growing(tmp_path_factory):
    folder = tmp_path_factory.mktemp("growing")
    for number, severity in enumerate(GROWING, start=6):  # 6 to 11: names need their numbers
        record_flight(folder, number, severity)
    return folder


@pytest.fixture
def damaged(growing, tmp_path):
    """The same with a cut, an empty and a copied bag, and notes beside them."""
    folder = tmp_path / "damaged"
    shutil.copytree(growing, folder)
    (folder / "flight_8" / "metadata.yaml").unlink()
    (folder / "flight_99").mkdir()
    shutil.copytree(folder / "flight_9", folder / "flight_9_copy")
    (folder / "notes.txt").write_text("mine")
    return folder


def bags_in(lines):
    return [json.loads(line)["bag"].rpartition("/")[2] for line in lines]


@pytest.mark.slow
def test_json_is_one_object_a_bag_in_the_order_of_the_flights(growing, capsys):
    assert run(["check", str(growing), "--json"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert bags_in(lines) == [f"flight_{n}" for n in range(6, 12)]
    verdicts = [json.loads(line) for line in lines]
    assert [v["fault_class"] for v in verdicts] == [None, *["turn_short"] * 5]
    assert all("reasons" in v and "alternatives" in v for v in verdicts)
    assert [v["flight"] for v in verdicts] == [1, 2, 3, 4, 5, 6]
    assert run(["check", str(growing), "--format", "csv"]) == 1
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert [row["flight"] for row in rows] == ["1", "2", "3", "4", "5", "6"]


def test_rows_announcements_and_plot(growing, capsys, tmp_path):
    plot = tmp_path / "flights.png"
    assert run(["check", str(growing), "--plot", str(plot)]) == 1
    text = capsys.readouterr().out
    rows = [line for line in text.splitlines() if "flight_" in line]
    assert [row.split()[0] for row in rows] == [str(n) for n in range(1, 7)]
    assert "HEALTHY" in rows[0]
    assert "turn short, phase b" in rows[1]
    assert "2026-09-" in rows[0]
    assert "first announced at flight 2, confirmed at flight 3" in " ".join(text.split())
    assert plot.read_bytes().startswith(PNG)
    assert run(["check", str(growing), "--plot", str(plot)]) == 2
    assert "never overwritten" in capsys.readouterr().err


def test_damaged_flights_are_shown_and_are_not_healthy(damaged, capsys):
    assert run(["check", str(damaged)]) == 2
    out, err = capsys.readouterr()
    text = " ".join(out.split())
    rows = [line for line in out.splitlines() if " flight_" in line]
    assert [row.split()[0] for row in rows] == ["1", "2", "3", "4", "4", "5", "6", "7"]
    assert "INCOMPLETE" in rows[2]
    assert "copy of flight 4" in rows[4]
    assert "INVALID" in rows[7]
    assert "2 of 7 flights gave no answer" in text
    assert "neither as healthy nor as faulty: 3, 7" in text
    assert "notes.txt" in err


@pytest.mark.parametrize("name", ["a_recovered", "z_recovered"])
def test_a_recovered_copy_hides_no_fault(growing, tmp_path, capsys, name):
    folder = tmp_path / "shadow"
    shutil.copytree(growing / "flight_9", folder / "flight_9")
    cut = tmp_path / "cut"
    shutil.copytree(growing / "flight_9", cut)
    (file,) = cut.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:file.stat().st_size * 2 // 3])
    (cut / "metadata.yaml").unlink()
    assert run(["recover", str(cut), "--out", str(folder / name)]) == 0
    capsys.readouterr()
    assert run(["check", str(folder)]) == 1
    rows = {line.split()[3]: line for line in capsys.readouterr().out.splitlines()
            if "flight_9" in line or name in line}
    assert "FAULT" in rows["flight_9"] and "turn short, phase b" in rows["flight_9"]
    assert "copy of flight" in rows[name]
    assert run(["trend", str(folder), "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert [f["fault_class"] for f in found["faults"]] == ["turn_short"]
    assert (len(found["copies"]), found["unanswered"]) == (1, [])
    assert run(["trend", str(folder)]) == 3
    text = " ".join(capsys.readouterr().out.split())
    assert "1 flight, 1 of them gave an answer" in text
    assert "the same flight once more, not counted again" in text and "no answer" not in text
    assert run(["trend", str(folder / name)]) == run(["check", str(folder / name)]) == 3
    capsys.readouterr()
    twice = ["--limit", "backlash=1mrad", "--limit", "backlash=2mrad"]
    assert run(["trend", str(folder), *twice]) == 2
    assert "--limit backlash: given twice, as 1mrad and as 2mrad" in capsys.readouterr().err


@pytest.mark.slow
def test_a_picture_that_fails_takes_no_answer_with_it(growing, tmp_path):
    """Matplotlib is set to draw its text with LaTeX, which is not there."""
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    environment = {**os.environ, "PATH": str(tmp_path), "MATPLOTLIBRC": str(tmp_path)}
    bag, out = str(growing / "flight_7"), str(tmp_path / "made")
    for arguments, told in (
        (["check", str(growing), "--plot", "a.png"], "FAULT"),
        (["check", str(growing), "--json", "--plot", "b.png"], '"turn_short"'),
        (["trend", str(growing), "--plot", "c.png"], "first announced at flight 2"),
        (["trend", str(growing), "--json", "--plot", "d.png"], '"turn_short"'),
        (["export", bag, "--format", "csv", "--out", "e.csv", "--plot", "e"], "e.csv"),
        (["simulate", "--profile", "step", "--out", out, "--json", "--plot", "f"], '"bag"'),
        (["simulate", "--profile", "step", "--out", out + "2", "--plot", "g"], "9000 samples"),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "ema_cli", *arguments], capture_output=True, text=True,
            check=False, cwd=tmp_path, env=environment,
        )
        assert told in done.stdout, arguments
        assert done.returncode not in (0, 1, 3), arguments
        assert done.stderr.count("\n") == 1, arguments
    assert not list(tmp_path.rglob("*.png"))
    assert (tmp_path / "e.csv").is_file()


@pytest.fixture
def two_units(growing, tmp_path):
    folder = tmp_path / "two"
    folder.mkdir()
    shutil.copytree(growing / "flight_7", folder / "flight_7")
    record_flight(folder, 3, 0.0, unit="SN-8")
    return folder


def test_units_are_not_mixed(two_units, capsys, tmp_path):
    folder = two_units
    assert run(["check", str(folder)]) == 1
    text = capsys.readouterr().out
    assert "Actuator SN-7, 1 flight\n" in text
    assert "Actuator SN-8, 1 flight\n" in text
    for command in ("check", "trend"):
        plot = tmp_path / f"{command}.png"
        assert run([command, str(folder), "--plot", str(plot)]) == 2
        error = capsys.readouterr().err
        assert "flights of 2 actuators (SN-7: 1, SN-8: 1)" in error
        assert not plot.exists()


def test_a_picture_is_of_one_bag_or_directory(growing, capsys, tmp_path):
    bag, plot = str(growing / "flight_6"), tmp_path / "a.png"
    for arguments, problem in (
        (["check", bag, bag, "--plot", str(plot)], "one bag, or one directory"),
        (["check", bag, "--plot", str(tmp_path / "a.bmp")], "end the name with .png, .svg, .pdf"),
        (["trend", bag, "--plot", str(tmp_path / "a")], "no ending"),
        (["check", str(tmp_path / "none"), "--plot", str(plot)], "no record to draw"),
    ):
        assert run(arguments) == 2
        assert problem in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_bag_beside_a_directory(growing, two_units, capsys):
    assert run(["check", str(growing / "flight_6"), str(two_units), "--json"]) == 1
    assert bags_in(capsys.readouterr().out.splitlines()) == ["flight_6", "flight_7", "flight_3"]


def test_trend_of_growth(growing, capsys, tmp_path):
    plot = tmp_path / "trend.png"
    assert run(["trend", str(growing), "--json", "--plot", str(plot)]) == 1
    found = json.loads(capsys.readouterr().out)
    (fault,) = found["faults"]
    assert (found["serial_number"], found["flights"]) == ("SN-7", 6)
    assert (fault["announced"], fault["confirmed"], fault["present"]) == (2, 3, True)
    low, high = fault["growth"]["rate_interval"]
    assert low < fault["growth"]["rate"] < high
    assert fault["growth"]["rate"] == pytest.approx(0.02, rel=0.15)
    assert [v["flight"] for v in found["verdicts"]] == list(range(1, 7))
    assert plot.read_bytes().startswith(PNG)


def test_trend_for_a_person(growing, capsys):
    bags = [str(growing / f"flight_{n}") for n in (11, 7, 9, 8, 10)]  # in any order
    assert run(["trend", *bags]) == 1
    text = capsys.readouterr().out
    assert "first announced at flight 1, confirmed at flight 2" in text
    assert "% of the turns a flight" in text
    assert "large (17 % of the turns) expected at flight" in text


@pytest.mark.parametrize(("numbers", "status"), [((6,), 0), ((7,), 3), ((6, 7, 8), 1)])
def test_trend_status(growing, capsys, numbers, status):
    assert run(["trend", *(str(growing / f"flight_{n}") for n in numbers)]) == status


def test_trend_of_nothing_readable(tmp_path, capsys):
    assert run(["trend", str(tmp_path / "none")]) == 2
    assert run(["trend", str(tmp_path), "--rule", "5/3"]) == 2
    assert "K/N" in capsys.readouterr().err


def test_trend_of_a_name_that_is_wrong_is_one_line(tmp_path, capsys):
    assert run(["trend", str(tmp_path / "none")]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1 and "no such file" in printed.err
