"""`ema profile` and `ema new-actuator` as a user meets them."""

import io
import json

import pytest

from ema_cli import main
from ema_record.profile import load_profile

SHEET = ["--resistance", "1.2ohm", "--inductance", "0.194mH", "--kv", "475rpm/V", "--pole-pairs",
         "1", "--inertia", "34gcm2", "--gear", "100", "--end-stop", "40deg", "--current-limit",
         "7.5A", "--bus", "24V"]


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_test_is_printed_in_every_unit(capsys):
    assert main.run(["profile", "extended"]) == 0
    printed = capsys.readouterr().out
    assert "1.48633  +0.10000     +16.7%    0.5000  +0.395     0.25   15.92  slew" in printed
    assert "quarter 1.09 to 1.458" in printed


def test_all_tests_of_the_kit_are_listed(capsys):
    assert main.run(["profile"]) == 0
    assert "extended     3.13  67 %" in capsys.readouterr().out


def test_a_designed_test_is_written_and_read_back(tmp_path, capsys):
    out = tmp_path / "test.yaml"
    assert main.run(["profile", "extended", "--design", "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert load_profile(out) == load_profile("extended")
    assert told["parts_after_first_command"]["least_time"] == 3.083
    assert told["within_end_stops"] is True


@pytest.mark.parametrize(("arguments", "message"), [
    (["profile", "extendd"], "did you mean 'extended'?"),
    (["profile", "steps", "--design"], "--design makes step and extended"),
    (["profile", "--out", "x.yaml"], "give one test"),
    (["profile", "step", "--out", "x.txt"], "ends in .yaml"),
    (["new-actuatr"], "did you mean 'new-actuator'?"),
    (["new-actuator"], "--out"),
])
def test_wrong_use_is_one_line(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main.run(arguments) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert list(tmp_path.iterdir()) == []


def test_a_kit_from_flags(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    kit = tmp_path / "kit"
    assert main.run(["new-actuator", "--out", str(kit), *SHEET, "--json", "--name", "\udcff"]) == 0
    assert (kit / "actuator.yaml").read_text(encoding="utf-8").startswith("# \\udcff, from its")
    told = json.loads(capsys.readouterr().out)
    assert told["actuator"]["motor"]["phase_resistance"]["origin"] == "given"
    assert main.run(["profile", "step", "--kit", str(kit)]) == 0
    assert main.run(["new-actuator", "--out", str(kit), *SHEET]) == 2
    assert "exists" in capsys.readouterr().err


def test_flags_that_lack_are_told_where_no_one_can_be_asked(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main.run(["new-actuator", "--out", str(tmp_path / "kit"), *SHEET[:-2]]) == 2
    captured = capsys.readouterr()
    assert captured.err == (
        "ema: the data sheet lacks --bus (24V): give them, or answer the questions at a "
        "terminal\n")
    assert list(tmp_path.iterdir()) == []


def test_what_lacks_is_asked_for_at_a_terminal(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", Terminal("24\n24V\nkv\n475rpm/V\n"))
    given = [a for a in SHEET if a not in ("--bus", "24V", "--kv", "475rpm/V")]
    assert main.run(["new-actuator", "--out", str(tmp_path / "kit"), *given]) == 0
    captured = capsys.readouterr()
    assert "bus, between the rails [e.g. 24V]: " in captured.err
    assert "--bus '24': the unit is missing" in captured.err
    assert (tmp_path / "kit" / "actuator.yaml").is_file()


def test_answers_that_end_leave_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", Terminal("24V\n"))
    given = [a for a in SHEET if a not in ("--bus", "24V", "--gear", "100")]
    assert main.run(["new-actuator", "--out", str(tmp_path / "kit"), *given]) == 2
    assert "nothing was written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("a90", "said"), [(None, True), (0.02, False)])
def test_a_kit_that_finds_no_fault_says_so(a90, said, tmp_path, capsys, monkeypatch):
    rate = {"count": 0, "total": 40, "lower": 0.0, "upper": 0.09}
    view = {"false alarms": rate, "healthy called unknown": rate, "turn_short": {"a90": None}}
    found = {"profile": "step", "units": ["a"], "library": True, "held_out": {
        "step": {"fleet": view, "baseline": view | {"backlash": {"a90": a90}}}}}
    monkeypatch.setattr(
        "ema_prognostics.commission.commission.commission", lambda *_, **__: found)
    assert main.run(["commission", "bags/sim_0000_step", "--actuator", "config/actuator.yaml",
                     "--out", str(tmp_path / "kit")]) == 0
    assert ("this kit finds no fault of any size" in capsys.readouterr().err) == said
