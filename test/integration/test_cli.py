"""`ema simulate` and `ema export` as a user calls them, good and bad input."""

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from ema_cli.main import run
from ema_record.bag.read import read_bag
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Return a bag of the step profile with a turn short, made by the command."""
    path = tmp_path_factory.mktemp("cli") / "bag"
    assert run(["simulate", "--profile", "step", "--seed", "7", "--effect",
                "turn_short.fraction=0.1", "--effect", "turn_short.phase=c", "--serial-number",
                "EMA-17", "--out", str(path)]) == 0
    return path


def refused(capsys, *arguments, status=2):
    """Run `ema`, expect one line on standard error and `status`; return the line."""
    assert run([str(a) for a in arguments]) == status
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    return captured.err


def test_simulate_writes_what_the_call_gives(bag):
    record = read_bag(bag)
    expected = simulate(
        load_profile("step"), seed=7,
        effects=parse_effects(["turn_short.fraction=0.1", "turn_short.phase=c"]),
    )
    assert np.array_equal(record.samples, expected.samples)
    assert record.provenance.serial_number == "EMA-17"
    assert record.provenance.start_time > 1_700_000_000 * 10**9


def test_no_bag_tells_what_was_hidden(bag):
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream)
        texts = [message.data for _, _, message in reader.iter_messages()]
    texts += [file.read_bytes(), (bag / "metadata.yaml").read_bytes()]
    assert any(b"motor_speed" in text for text in texts)  # messages are looked into
    assert not [text for text in texts if b"turn_short" in text or b"fraction" in text]


def test_simulate_json_negative_numbers_and_trace(tmp_path, capsys):
    out, trace = tmp_path / "bag", tmp_path / "trace.csv"
    assert run(["simulate", "--step", "-0.15", "--start-angle", "-1.5", "--noise", "0", "--rate",
                "10000", "--out", str(out), "--trace", str(trace), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    record = read_bag(out)
    assert told["bag"] == str(out)
    assert told["samples"] == len(record) == 4500
    assert record.profile.points[-1][1] == pytest.approx(-0.55)
    assert record.channel("rotor_angle")[0] == pytest.approx(2.0 * np.pi - 1.5, abs=1e-3)
    with trace.open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time[s]", "motor_torque[N m]", "shaft_torque[N m]", "surface_speed[rad/s]"]
    values = np.array(rows[1:], dtype=float)
    assert values[:, 0] == pytest.approx(record.time)
    slew = (record.time > 0.05) & (record.time < 0.1)
    assert values[slew, 3].mean() == pytest.approx(-790.6 / 500.0, rel=0.02)


def test_model_file_and_profile_file(tmp_path):
    model = tmp_path / "model.yaml"
    model.write_text("control:\n  speed_limit: 400.0\n", encoding="utf-8")
    profile = tmp_path / "mine.yaml"
    profile.write_text(
        "name: mine\npoints: [[0.0, 0.0], [0.03, 0.0], [0.03, 0.2], [0.2, 0.2]]\n",
        encoding="utf-8",
    )
    assert run(["simulate", "--profile", str(profile), "--model", str(model), "--out",
                str(tmp_path / "bag")]) == 0
    record = read_bag(tmp_path / "bag")
    assert record.profile.name == "mine"
    late = record.time > 0.15
    assert record.channel("motor_speed")[late].mean() == pytest.approx(400.0, rel=0.01)


@pytest.mark.slow
def test_the_edges_of_a_carrier(tmp_path):
    """With them the current has the ripple of the carrier, as the call gives it."""
    model, profile = tmp_path / "model.yaml", tmp_path / "mine.yaml"
    model.write_text("drive: {kind: pwm, proportional_gain: 4.0, integral_gain: 1200.0}\n",
                     encoding="utf-8")
    profile.write_text("name: mine\npoints: [[0.0, 0.0], [0.03, 0.0], [0.03, 0.2], [0.06, 0.2]]\n",
                       encoding="utf-8")
    found = []
    for more in ([], ["--switching"]):
        bag = tmp_path / f"bag{len(more)}"
        assert run(["simulate", "--profile", str(profile), "--model", str(model), "--noise", "0",
                    "--out", str(bag), *more]) == 0
        found.append(read_bag(bag))
    loaded = load_model_file(model)
    edges = simulate(found[0].profile, actuator=loaded.actuator, noise=0.0, switching=True)
    assert np.array_equal(found[1].samples, edges.samples)
    assert not np.array_equal(found[0].samples, edges.samples)


@pytest.mark.slow
def test_simulate_and_export_plots(tmp_path, bag, capsys):
    made = tmp_path / "made"
    assert run(["simulate", "--profile", "step", "--out", str(tmp_path / "b"), "--plot",
                str(made)]) == 0
    capsys.readouterr()
    assert run(["export", str(bag), "--plot", str(tmp_path / "from_bag"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    names = ["speed.png", "currents.png", "spectrum.png", "surface.png", "torque.png"]
    assert sorted(p.name for p in made.iterdir()) == sorted(names)
    assert told["written"] == [str(tmp_path / "from_bag" / name) for name in names]
    assert not list(bag.parent.glob("*.csv"))


@pytest.mark.slow
def test_lint_and_export_take_a_directory_of_bags(tmp_path, bag, capsys):
    for name in ("one", "two"):
        shutil.copytree(bag, tmp_path / name)
    (tmp_path / "notes.txt").write_text("no bag", encoding="utf-8")
    assert run(["lint", str(tmp_path), "--json"]) == 0
    captured = capsys.readouterr()
    assert [Path(json.loads(line)["bag"]).name for line in captured.out.splitlines()] == [
        "one", "two"]
    assert "notes.txt" in captured.err
    assert run(["export", str(tmp_path), "--plot", str(tmp_path / "p"), "--format", "csv"]) == 0
    assert {p.name for p in tmp_path.glob("*.csv")} == {"one.csv", "two.csv"}
    assert all((tmp_path / "p" / name / "speed.png").is_file() for name in ("one", "two"))
    capsys.readouterr()
    assert "2 bags" in refused(capsys, "export", tmp_path / "one", tmp_path / "two", "--out",
                               tmp_path / "x.csv")


BAD_SETTINGS = [
    (["--effect", "turn_shrt.fraction=0.1"], "did you mean 'turn_short'?"),
    (["--effect", "turn_short.fractoin=0.1"], "did you mean 'fraction'?"),
    (["--effect", "turn_short.fraction=1.5"], "give 0 to 0.9"),
    (["--effect", "turn_short.fraction=nan"], "out of bounds"),
    (["--effect", "turn_short.phase=d"], "a, b, c"),
    (["--effect", "turn_short"], "NAME.PARAMETER=VALUE"),
    (["--profile", "stepp"], "did you mean 'step'?"),
    (["--profile", "absent.yaml"], "absent.yaml"),
    (["--model", "absent.yaml"], "absent.yaml"),
    (["--profile", "step", "--step", "0.1"], "exclude each other"),
    (["--campaign", "absent.yaml", "--seed", "0"], "--seed and --campaign exclude each other"),
    (["--step", "1.5"], "end stops"),
    (["--step", "100"], "--step 100: not within the end stops: give a finite number, -0.2 to 1"),
    (["--effect", "a.x=1", "--effect", "a.x=2"], "--effect a.x: given twice, as 1 and as 2"),
    (["--trace", "bag"], "two results in one place"),
    (["--trace", "t", "--plot", "./t"], "two results in one place"),
    (["--step", "nan"], "finite"),
    (["--seed", "-1"], "seed"),
    (["--noise", "-1"], "noise"),
    (["--noise", "inf"], "noise"),
    (["--rate", "1"], "rate"),
    (["--serial-number", 201 * "7"], "at most 200 characters that can be printed (given: 201)"),
    (["--serial-number", "7\n8"], "that can be printed"),
]


@pytest.mark.parametrize(("arguments", "expected"), BAD_SETTINGS)
def test_bad_settings(arguments, expected, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert expected in refused(capsys, "simulate", "--out", "bag", *arguments)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("name: [", "malformed YAML"),
        ("name: x\npoints: [[0, 0], [1, 99]]\n", "points"),
        ("name: x\npoints: [[1, 0], [0.5, 0]]\n", "must not decrease"),
        ("&a [*a]", "YAML"),
        ("- 1\n", "profile"),
        ("", "profile"),
    ],
)
def test_bad_profile_files(text, expected, tmp_path, capsys):
    path = tmp_path / "bad.yaml"
    path.write_text(text, encoding="utf-8")
    line = refused(capsys, "simulate", "--profile", path, "--out", tmp_path / "bag")
    assert str(path) in line
    assert expected in line


def test_existing_outputs_are_kept(tmp_path, bag, capsys):
    kept = tmp_path / "kept"
    kept.write_text("mine", encoding="utf-8")
    trace = ["--trace", kept]
    for arguments in (
        ["simulate", "--profile", "step", "--out", kept],
        ["simulate", "--profile", "step", "--out", bag],
        ["simulate", "--profile", "step", "--out", tmp_path / "new", *trace],
        ["export", bag, "--format", "csv", "--out", kept],
    ):
        assert "never overwritten" in refused(capsys, *arguments)
    assert kept.read_text(encoding="utf-8") == "mine"
    assert [p.name for p in tmp_path.iterdir()] == ["kept"]


def test_unwritable_place_is_one_line(bag, capsys):
    """/proc takes no new files from anybody, root included."""
    for arguments in (
        ["simulate", "--profile", "step", "--out", "/proc/bag"],
        ["export", bag, "--format", "csv", "--out", "/proc/a.csv"],
        ["export", bag, "--plot", "/proc/plots"],
    ):
        line = refused(capsys, *arguments)
        assert "/proc/" in line


def test_no_permission_is_one_line(tmp_path, bag):
    """As a user without rights: root is not stopped by permissions, so rights are dropped."""
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o555)
    command = [sys.executable, "-m", "ema_cli", "export", str(bag), "--format", "csv",
               "--out", str(closed / "a.csv")]
    if os.geteuid() == 0:
        drop = (
            "import os,sys,ctypes;"
            "c=ctypes.CDLL(None);[c.prctl(24,n,0,0,0) for n in range(41)];"  # PR_CAPBSET_DROP
            "os.execv(sys.argv[1],sys.argv[1:])"
        )
        command = [sys.executable, "-c", drop, *command]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert str(closed) in done.stderr
    assert "ermission" in done.stderr
    assert not list(closed.iterdir())


def test_export_of_what_is_no_bag(tmp_path, bag, capsys):
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.mcap").write_text("no mcap", encoding="utf-8")
    (tmp_path / "empty.mcap").touch()
    out = ["--format", "csv", "--out", tmp_path / "a.csv"]
    for name in ("absent", "folder", "text.mcap", "empty.mcap"):
        line = refused(capsys, "export", tmp_path / name, *out)
        assert str(tmp_path / name) in line
    assert "did you mean 'parquet'?" in refused(
        capsys, "export", bag, "--format", "parqet", "--out", tmp_path / "a.pq"
    )
    assert ".npz is the ending of no format" in refused(
        capsys, "export", bag, "--out", tmp_path / "a.npz")
    assert "make them agree" in refused(
        capsys, "export", bag, "--format", "csv", "--out", tmp_path / "a.parquet")
    assert not (tmp_path / "a.csv").exists()
    assert run(["export", str(bag), "--out", str(tmp_path / "b.parquet")]) == 0
    assert (tmp_path / "b.parquet").read_bytes()[:4] == b"PAR1"


def test_export_of_a_cut_bag_is_refused(tmp_path, bag, capsys):
    cut = tmp_path / "cut"
    cut.mkdir()
    (file,) = bag.glob("*.mcap")
    data = file.read_bytes()
    (cut / "cut_0.mcap").write_bytes(data[: len(data) // 2])
    refused(capsys, "export", cut, "--format", "csv", "--out", tmp_path / "a.csv", status=3)
    assert not (tmp_path / "a.csv").exists()
