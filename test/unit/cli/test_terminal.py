"""The terminal: rows that fit, completion, what a bag holds, how a process ends."""

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from rich.console import Console

from ema_cli import console
from ema_cli.commands.completion import follow
from ema_cli.lines import TextLine, print_lines, print_rows
from ema_cli.main import COMMANDS, run

HEARD = ("import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
         "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n")
"""What a process begins with that is to hear signals, though the tests run after ``nohup``."""


def shown(width, draw, *arguments):
    text = io.StringIO()
    draw(*arguments, Console(file=text, width=width, markup=False, highlight=False))
    return text.getvalue().splitlines()


@pytest.mark.parametrize("width", [60, 80, 200])
def test_rows_keep_to_the_width_and_break_no_word(width):
    rows = [["1", ("FAULT", "bold"), "turn short, phase b 9.92 % (9.28 to 10.6), medium; " * 3]]
    lines = shown(width, print_rows, ["flight", "verdict", "severity"], rows)
    assert all(len(line) <= width for line in lines)
    said = " ".join(" ".join(lines[1:]).split())
    assert said == f"1 FAULT {rows[0][2].strip()}"
    assert not any(line.endswith((" 9.92", "phas")) for line in lines)


def test_a_command_is_never_broken_and_an_empty_line_is_empty():
    command = "ema\u00a0report\u00a0a/very/long/path/of/a/record\u00a0--out\u00a0page.html"
    given = [TextLine("Next", command), TextLine(None, ""), TextLine("Do", "x")]
    lines = shown(40, print_lines, given)
    assert lines[1:] == ["", "  Do    x"]
    assert command.replace("\u00a0", " ") in lines[0]


@pytest.mark.parametrize(("line", "expected"), [
    ("ema che", ["check"]), ("ema ", [*sorted([*COMMANDS, "--help", "--version"])]),
    ("ema simulate --effect turn_short.ph", [f"turn_short.phase={p}" for p in "abc"]),
    ("ema simulate --effect backlash.", ["backlash.increase="]),
    ("ema check --ver", ["--verbose"]), ("ema bit -p ste", ["step", "steps"]),
    ("ema effects turn_", ["turn_short"]), ("ema check --lang ", ["de", "en"]),
    ("ema man fl", ["fleet"]),
    ("ema trend x --limit f", ["friction="]), ("ema check bags/", []), ("ema nothing x", []),
    ("ema simulate --out ", []), ("", ["check"]),
])
def test_completion(line, expected):
    found = follow(line)
    assert found == expected or (not line and set(expected) < set(found))


def test_completion_knows_the_kits_here(tmp_path, monkeypatch):
    (tmp_path / "kits" / "aileron").mkdir(parents=True)
    (tmp_path / "kits" / "aileron" / "actuator.yaml").touch()
    monkeypatch.chdir(tmp_path)
    assert follow("ema check --kit ki") == ["kits/aileron"]


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash: its completion is NOT tested")
def test_bash_takes_the_completion(capsys, tmp_path):
    assert run(["completion", "bash"]) == 0
    (tmp_path / "ema").write_text("#!/bin/sh\necho turn_short.phase=a; echo turn_short.phase=b\n")
    (tmp_path / "ema").chmod(0o755)
    script = capsys.readouterr().out + (
        "\nCOMP_LINE='ema simulate --effect turn_short.phase='; COMP_POINT=${#COMP_LINE}; _ema"
        '\necho "${COMPREPLY[@]}"')
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True,
                          env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"})
    assert done.stdout == "a b\n"  # bash breaks words at =
    assert run(["completion", "tcsh"]) == 2


def test_info(repository, capsys):
    bag = str(repository / "bags" / "sim_0001_step")
    assert run(["info", bag, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["serial number"], found["test"], found["samples"]) == ("SIM-0001", "step", 9000)
    assert len(found["channels"]) == 10 and found["not recorded"] == []
    assert run(["info", bag]) == 0
    assert "serial number  SIM-0001" in capsys.readouterr().out
    assert run(["info", "nowhere"]) == 2


def test_help_shows_no_types_of_python(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    for name in ("check", "simulate", "import"):
        assert run([name, "--help"]) == 0
        text = capsys.readouterr().out
        assert not any(word in text for word in ("<bool>", "<str>", "<path>", "list[", "<int>"))


PRINTED = [["--help"], *([name, "--help"] for name in COMMANDS),
           ["effects"], ["effects", "turn_short"], ["effects", "rotor_eccentricity"], ["profile"],
           ["profile", "extended"], ["explain"], ["explain", "turn_short"], ["info", "BAG"],
           ["lint", "BAG"], ["check", "BAG", "-v"]]


@pytest.mark.parametrize("width", [60, 200])
def test_what_is_printed_fits_and_is_not_cut(width, capsys, monkeypatch, repository):
    monkeypatch.chdir(repository / "bags")
    monkeypatch.setenv("COLUMNS", str(width))
    wide, cut = [], []
    for arguments in PRINTED:
        run([a.replace("BAG", "sim_0000_step") for a in arguments])
        lines = capsys.readouterr().out.splitlines()
        # What is there to be copied is one line on every terminal.
        wide += [line for line in lines if len(line) > width and " ema " not in line]
        cut += [(arguments, line) for line in lines if "\u2026" in line]
    assert (wide, cut) == ([], [])


def test_a_usage_has_the_names_as_they_are_given(capsys):
    for name, usage in (("check", "[OPTIONS] BAG..."), ("recover", "[OPTIONS] BAG..."),
                        ("effects", "[OPTIONS] [NAME]"),
                        ("explain", "[OPTIONS] [FAULT|REASON|CHECK|TERM]...")):
        assert run([name, "--help"]) == 0
        assert f"Usage: ema {name} {usage} " in " ".join(capsys.readouterr().out.split())


def test_version_quiet_and_colour(capsys, repository):
    assert run(["-V"]) == 0
    assert capsys.readouterr().out.startswith("ema ")
    assert run(["explain", "gap", "--color", "always"]) == 0
    assert "\x1b[" in capsys.readouterr().out
    assert run(["explain", "gap", "--color", "never"]) == 0
    assert "\x1b[" not in capsys.readouterr().out
    assert run(["explain", "gap", "--color", "red"]) == 2
    capsys.readouterr()
    with console.speaking(verbose=False, quiet=True):
        console.note("not said")
    assert capsys.readouterr().err == ""
    assert not {"NO_COLOR", "FORCE_COLOR"} & set(os.environ)


@pytest.mark.parametrize(("elapsed", "part", "says"), [
    (30.0, 0.25, "2 min left"), (10.0, 0.5, "10 s left"), (600.0, 0.05, "3 h left"),
    (50.0, 0.5, "50 s left"), (2.0, 0.5, ""), (30.0, 0.0, ""), (30.0, 1.0, ""),
])
def test_time_left_at_the_pace_so_far(elapsed, part, says):
    assert console.time_left(elapsed, part) == says


def test_long_work_shows_its_share_and_the_time_left(monkeypatch):
    shown = io.StringIO()
    monkeypatch.setattr(shown, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setattr(console, "SOON", 0.0)
    monkeypatch.setattr(console, "stderr", lambda: Console(
        file=shown, force_terminal=True, width=100, markup=False, highlight=False))
    with console.progress_of("training") as update:
        update("healthy fleet, 10 of 40 units", 0.25)
        time.sleep(0.2)  # the bar is drawn ten times a second
    seen = shown.getvalue()
    assert "healthy fleet, 10 of 40 units" in seen
    assert " 25 %" in seen and " s left" in seen


def test_long_work_tells_its_share_and_the_time_left_in_a_pipe(monkeypatch, capsys):
    """A line now and then; what was there when it began says nothing of the pace."""
    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.progress_of("identify") as update:
        for seconds, part in ((1.0, 0.5), (4.0, 0.51), (13.0, 0.60), (14.0, 0.61), (31.0, 0.75),
                              (32.0, 0.0), (43.0, 0.2)):
            now[0] = seconds
            update("library of step", part)
    assert capsys.readouterr().err.splitlines() == [
        "library of step: 60 %, 48 s left", "library of step: 75 %, 30 s left",
        "library of step: 20 %, 44 s left"]


def test_sigterm_ends_quietly_with_its_own_status():
    code = ("import os, signal, sys\nfrom ema_cli import ending\nending.end_quietly()\n"
            "def work():\n    os.kill(os.getpid(), signal.SIGTERM)\n    signal.pause()\n"
            "ending.leave(ending.guarded(work))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                          check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (
        128 + signal.SIGTERM, "", "ema: terminated\n")


def test_ctrl_c_in_code_made_of_text_has_its_status_too(tmp_path):
    """Python's ``-m`` ended by SIGINT where it met the making of a dataclass."""
    (tmp_path / "made.py").write_text(
        f"{HEARD}from ema_cli import ending\nending.end_quietly()\n"
        "code = 'import os, signal; os.kill(os.getpid(), signal.SIGINT); signal.pause()'\n"
        "ending.leave(ending.guarded(lambda: exec(code)))")
    done = subprocess.run([sys.executable, "-m", "made"], capture_output=True, text=True,
                          check=False, timeout=60, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (
        128 + signal.SIGINT, "", "ema: interrupted\n")


@pytest.mark.parametrize(("number", "line"), [
    (signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated"),
    (signal.SIGHUP, "interrupted")])
def test_a_signal_is_held_back_until_it_is_asked_for(number, line):
    code = (f"{HEARD}import os, sys\nfrom ema_cli import ending\nending.end_quietly()\n"
            "def work():\n    with ending.held_signals() as check:\n"
            "        check()\n"
            f"        os.kill(os.getpid(), {int(number)})\n        print('whole', flush=True)\n"
            "        CHECK\n    print('after')\n"
            "ending.leave(ending.guarded(work))")
    for last in ("check(); print('checked')", "pass"):
        done = subprocess.run([sys.executable, "-c", code.replace("CHECK", last)], check=False,
                              capture_output=True, text=True, timeout=60)
        status = 143 if number == signal.SIGTERM else 130
        assert (done.returncode, done.stdout, done.stderr) == (
            status, "whole\n", f"ema: {line}\n")


@pytest.mark.parametrize("encoding", ["latin-1", "ascii", "utf-8"])
def test_json_is_json_in_any_encoding(encoding):
    code = "from ema_cli.console import print_json; print_json({'unit': 'H\u00f6henruder \u2192'})"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True,
                           env={**os.environ, "PYTHONIOENCODING": encoding})
    assert json.loads(found.stdout.decode(encoding)) == {"unit": "H\u00f6henruder \u2192"}
