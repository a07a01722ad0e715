"""`ema import` and `ema identify` on a rig's file as its user runs them: terminal and errors."""

import json
import os
import pty
import shutil
import subprocess
import sys

import numpy as np
import pytest

from ema_cli.main import run

MAP = """name: drive
axis: rotary
format: {delimiter: semicolon, decimal: ","}
time: {column: t, unit: ms}
input: {column: i, unit: mA}
position: {column: q, unit: deg}
speed: {column: n, unit: rpm}
"""


def table(duration=12.0, still=False, hold=0, friction=300, seed=3):
    """Return CSV text of a drive with dry friction, with `;` and decimal commas, 250 1/s."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 0.004)
    q = np.zeros_like(t)
    v, a = q.copy(), q.copy()
    for k, f in enumerate((0.4, 0.65, 1.1)):
        size, w = (0.0 if still else 2.0 / (k + 1)), 2 * np.pi * f
        q += size * np.sin(w * t + k)
        v += size * w * np.cos(w * t + k)
        a -= size * w**2 * np.sin(w * t + k)
    i = 20 * a + 60 * v + friction * np.sign(v) + 10 * rng.standard_normal(len(t))
    i = np.roll(i, -hold)
    rows = zip(1e3 * t, i, np.degrees(q) + 1e-3 * rng.standard_normal(len(t)),
               v * 60 / (2 * np.pi) + 0.05 * rng.standard_normal(len(t)))
    text = "\n".join(";".join(f"{x:.6f}" for x in row) for row in rows)
    return "Drive 7;;;\nt;i;q;n\n" + text.replace(".", ",") + "\n"


def imported(folder, text, map_text=MAP):
    (folder / "run.csv").write_text(text, encoding="utf-8")
    (folder / "map.yaml").write_text(map_text, encoding="utf-8")
    return run(["import", str(folder / "run.csv"), "--map", str(folder / "map.yaml"), "--out",
                str(folder / "bag")])


@pytest.mark.slow
def test_progress_is_seen_at_a_terminal_and_the_answer_after_it(tmp_path):
    assert imported(tmp_path, table(8.0)) == 0
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", "from ema_cli.main import main; main()", "identify",
         str(tmp_path / "bag"), "--out", str(tmp_path / "report")], stdin=theirs,
        stdout=theirs, stderr=theirs, close_fds=True,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "120", "OMP_NUM_THREADS": "1"})
    os.close(theirs)
    seen = b""
    try:
        while block := os.read(ours, 4096):
            seen += block
    except OSError:  # Linux: the other side was closed
        pass
    finally:
        os.close(ours)
    assert process.wait(60) == 0
    text = seen.decode()
    assert "screening" in text
    assert "looking where they disagree" in text
    assert text.index("screening") < text.rindex("explained")
    assert "coulomb_friction.level" in text
    assert "Traceback" not in text


@pytest.mark.parametrize(("text", "old", "new", "says"), [
    (table(), "column: n,", "column: speed,", "no column"),
    (table(), "unit: rpm", "unit: rd/s", "unit"),
    (table(), "unit: mA", "unit: mm", "measures none of"),
])
def test_a_wrong_map_is_one_line(tmp_path, capsys, text, old, new, says):
    assert imported(tmp_path, text, MAP.replace(old, new)) == 2
    line = capsys.readouterr().err.strip()
    assert "\n" not in line
    assert says in line or new.split()[-1].strip(",") in line


@pytest.mark.parametrize(("arguments", "says"), [
    (["import", "run.csv", "--map", "map.yaml", "--topic", "/a"], "leave them out"),
    (["import", "run.csv", "--set", "axis=linear", "--set", "axis=rotary"],
     "--set axis: given twice, as linear and as rotary"),
    (["identify", "bag", "--out", "r", "--profile", "step"], "a rig has none"),
])
def test_what_cannot_be_meant_is_one_line(tmp_path, capsys, monkeypatch, arguments, says):
    assert imported(tmp_path, table()) == 0
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    assert run(arguments) == 2
    error = capsys.readouterr().err.strip()
    assert says in error and "\n" not in error


@pytest.mark.parametrize(("text", "old", "new", "says"), [
    (table(0.6), "", "", "too short"),
    (table(still=True), "", "", "record a run with reversals"),
    (table(), "unit: rpm", "unit: rad/s", "rev/min (rpm)"),
])
def test_a_record_that_cannot_be_used_is_one_line(tmp_path, capsys, text, old, new, says):
    assert imported(tmp_path, text, MAP.replace(old, new)) == 0
    capsys.readouterr()
    assert run(["identify", str(tmp_path / "bag"), "--out", str(tmp_path / "report")]) != 0
    line = capsys.readouterr().err.strip()
    assert "\n" not in line
    assert says in line
    assert not (tmp_path / "report").exists()


def test_an_unknown_law_in_the_model_file_is_one_line(tmp_path, capsys):
    assert imported(tmp_path, table()) == 0
    (tmp_path / "m.yaml").write_text("rig: r\nterms: [{effect: colomb_friction}]\n")
    capsys.readouterr()
    assert run(["identify", str(tmp_path / "bag"), "--model", str(tmp_path / "m.yaml"), "--out",
                str(tmp_path / "report")]) == 2
    line = capsys.readouterr().err.strip()
    assert "did you mean 'coulomb_friction'" in line
    assert "\n" not in line


@pytest.fixture
def wearing(tmp_path):
    """Return a folder of runs whose friction grows by 20 mA from the third on, and their map."""
    folder = tmp_path / "runs"
    folder.mkdir()
    for k in range(7):
        (folder / f"run_{k + 5}.csv").write_text(  # 5 to 11: names need their numbers
            table(8.0, friction=300 + 20 * max(0, k - 1), seed=k), encoding="utf-8")
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    (tmp_path / "model.yaml").write_text(
        "rig: drive\nterms:\n- effect: inertia\n- effect: viscous_friction\n")
    return tmp_path


@pytest.mark.slow
def test_the_trend_of_files_says_what_grows_and_when_it_reaches_a_limit(wearing, capsys):
    options = ["trend", str(wearing / "runs"), "--map", str(wearing / "map.yaml"), "--model",
               str(wearing / "model.yaml"), "--limit", "coulomb_friction.level=0.5"]
    assert run([*options, "--json", "--plot", str(wearing / "trend.png")]) == 3
    found = json.loads(capsys.readouterr().out)
    assert [r["source"].rpartition("_")[2] for r in found["records"]] == [
        f"{k}.csv" for k in range(5, 12)]
    values = {v["name"]: v for v in found["values"]}
    friction = values.pop("coulomb_friction.level")
    assert friction["now"] == pytest.approx(0.4, abs=0.01)
    assert friction["growth"]["interval"][0] <= 0.02 <= friction["growth"]["interval"][1]
    first, last = friction["limit"]["interval"]
    assert first <= 12 <= last  # 0.4 A at the seventh, 0.02 A more each
    assert {v["way"] for v in values.values()} == {"steady"}
    assert (wearing / "trend.png").read_bytes()[:4] == b"\x89PNG"
    assert run([*options, "--format", "json", "--plot", str(wearing / "trend.svg")]) == 3
    assert json.loads(capsys.readouterr().out) == found
    assert (wearing / "trend.svg").read_text(encoding="utf-8").startswith("<?xml")
    assert run([*options, "--format", "csv"]) == 2
    assert "text or json" in capsys.readouterr().err
    assert run([*options, "--limit", "coulomb_friction.level=+10%"]) == 1
    assert "limit 0.3" in (out := capsys.readouterr().out) and "passed" in out


def test_a_record_that_is_given_twice_counts_once(tmp_path, capsys):
    assert imported(tmp_path, table()) == 0
    shutil.copytree(tmp_path / "bag", tmp_path / "copy")
    capsys.readouterr()
    assert run(["trend", str(tmp_path / "bag"), str(tmp_path / "copy"), "--json"]) == 0
    records = json.loads(capsys.readouterr().out)["records"]
    assert [r["reason"] is None for r in records] == [True, False]
    assert "once more, not counted again" in records[1]["reason"]
    (tmp_path / "later").mkdir()  # no bag at all: it may be the newest record
    assert run(["trend", str(tmp_path / "bag"), str(tmp_path / "later")]) in (2, 3)


@pytest.mark.parametrize(("option", "says"), [
    ("friction", "NAME=VALUE"), ("coulomb_friction.level=", "NAME=VALUE"),
    ("coulomb.level=1", "coulomb_friction.level"), ("inertia.value=1.2.3", "NAME=VALUE"),
])
def test_a_wrong_limit_is_one_line(wearing, capsys, option, says):
    assert run(["trend", str(wearing / "runs" / "run_5.csv"), "--map", str(wearing / "map.yaml"),
                "--model", str(wearing / "model.yaml"), "--limit", option]) == 2
    error = capsys.readouterr().err
    assert says in error and "Traceback" not in error


def test_a_trend_of_a_rig_has_no_baseline_and_needs_something_to_read(wearing, capsys):
    assert run(["trend", str(wearing / "runs"), "--map", str(wearing / "map.yaml"),
                "--baseline", str(wearing)]) == 2
    assert "--baseline" in capsys.readouterr().err
    (wearing / "empty").mkdir()
    assert run(["trend", str(wearing / "empty"), "--map", str(wearing / "map.yaml")]) == 2
    (wearing / "runs" / "run_5.csv").write_text("no;table\n")
    assert run(["trend", str(wearing / "runs" / "run_5.csv"), "--map",
                str(wearing / "map.yaml")]) == 2
    assert "run_5.csv" in capsys.readouterr().out
