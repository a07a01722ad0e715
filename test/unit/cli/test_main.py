"""The `ema` command: help, dispatch, errors as one line with their status."""

import errno
import importlib
import inspect
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ema_cli import console, ending, main
from ema_cli.commands.train import print_report
from ema_record.errors import IncompleteRecordError, OutputError, UsageError
from ema_record.version import VERSION


def ema(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", "ema_cli", *arguments], capture_output=True, text=True,
        timeout=120, check=False, **options,
    )


def said(name):
    """Return the summary and the example that the docstring of a command ends with."""
    lines = inspect.cleandoc(main.load_command(name).__doc__).splitlines()
    return lines[0], lines[-1].removeprefix("Example: `").removesuffix("`")


def test_help_names_every_command_with_its_example(capsys):
    assert main.run(["--help"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for name in main.COMMANDS:
        summary, example = said(name)
        assert f"{name} {summary} ema {name}" in printed
        assert example in printed


@pytest.mark.parametrize("name", main.COMMANDS)
def test_every_command_is_there_and_its_help_has_options_and_example(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert main.run([name, "--help"]) == 0
    printed = capsys.readouterr().out
    assert all(text in printed for text in said(name))
    assert printed.count("--") >= 2
    assert "----" not in printed


def test_main_imports_no_heavy_module():
    code = (
        "import sys, ema_cli.main as m; m.run(['--version']);"
        "print([n for n in ('numpy', 'numba', 'rclpy', 'scipy', 'matplotlib', 'mcap')"
        " if n in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[:2] == [f"ema {VERSION}", "[]"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["simulat"], "did you mean 'simulate'?"),
        (["--hlep"], "did you mean '--help'?"),
        (["simulate", "--effct", "a"], "did you mean '--effect'"),
        (["simulate"], "--out"),
        (["simulate", "--seed", "x", "--out", "nowhere"], "(value x)"),
        (["bit", "--domain", "500"], "'--domain': expected a number from 0 to 232 (value 500)"),
        (["simulate", "--seed", "x"], "'--seed': expected a whole number from 0 to 2147483647 ("),
        (["fleet", "--watch", "0"], "'--watch': expected a number from 0.5 to 604800 (value 0)"),
        (["fleet", "--watch", "inf"], "'--watch': expected a number from 0.5 to 604800 (v"),
        (["simulate", "--noise", "x"], "'--noise': expected a number (value x);"),
        (["bit", "--effect", "turn_shrt.fraction=1"], "did you mean 'turn_short'"),
        (["bit", "--noise", "nan"], "noise: nan is out of bounds: give 0 to 100"),
        (["bit", "--real-time-factor=-1"], "-1 is out of bounds: give 0 to 1000"),
        (["simulate", "--seed"], "'--seed' requires an argument; see 'ema simulate --help'"),
        (["effects", "one", "two"], "two"),
        (["man", "--out", os.devnull], "cannot be written (File exists): choose a folder"),
    ],
)
def test_wrong_use_is_one_line_and_status_2(arguments, expected, capsys):
    assert main.run(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert expected in captured.err


@pytest.mark.parametrize("arguments", [
    ["check", ""], ["trend", ""], ["lint", "bags", ""], ["export", ""], ["replay", ""],
    ["recover", ""], ["identify", ""], ["check", "bags", "--plot="],
])
def test_an_empty_argument_is_no_folder(arguments, capsys):
    """`ema check "$BAG"` without BAG does not judge the folder one happens to be in."""
    assert main.run(arguments) == 2
    captured = capsys.readouterr()
    assert (captured.out, captured.err.count("\n")) == ("", 1)
    assert "empty" in captured.err


def test_no_arguments_prints_help_and_is_wrong_use(capsys):
    assert main.run([]) == 2
    assert "simulate" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("error", "status", "expected"),
    [
        (UsageError("wrong\n  name"), 2, "ema: wrong name"),
        (IncompleteRecordError("cut"), 3, "ema: cut"),
        (KeyboardInterrupt(), 130, "ema: interrupted"),
        (PermissionError(errno.EACCES, "Permission denied", "a.txt"), 2, "a.txt: Permission"),
        (OSError(errno.ENOSPC, "No space left on device"), 2, "free some disk space"),
        (MemoryError(), 2, "not enough memory"),
        (ModuleNotFoundError("no", name="rclpy.node"), 2, "ema_phm[ros]"),
        (ModuleNotFoundError("no", name="pyarrow"), 2, "'pyarrow' is not installed"),
        (ZeroDivisionError("x"), 70, "internal error (ZeroDivisionError: x)"),
    ],
)
def test_errors_are_one_line_with_their_status(error, status, expected, capsys):
    def command():
        raise error

    assert ending.guarded(command) == status
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert expected in captured.err
    assert "Traceback" not in captured.err


@pytest.mark.parametrize("arguments", [
    ["effects", "--json"], ["effects"], ["--help"], ["check", "--help"],
    ["check", "bags/sim_0000_step"],
])
def test_closed_pipe_is_quiet(arguments, repository):
    process = subprocess.Popen(
        [sys.executable, "-m", "ema_cli", *arguments], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, cwd=repository,
    )
    process.stdout.close()
    complaint = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=60) == 141
    assert complaint == b""


@pytest.mark.slow
@pytest.mark.parametrize("pipe", [
    "check bags/sim_0000_step | head -1", "-h | head -3", "effects | head -1",
])
def test_a_reader_that_leaves_early_never_looks_like_a_fault(pipe, repository):
    """All was read before it left, or the pipe was closed: 0 or 141, every time."""
    command = f"set -o pipefail; {sys.executable} -m ema_cli {pipe}"
    for _ in range(4):
        done = subprocess.run(["bash", "-c", command], capture_output=True, text=True,
                              check=False, cwd=repository)
        assert done.returncode in (0, 141)
        assert (len(done.stdout.splitlines()) > 0, done.stderr) == (True, "")


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_full_disk_is_one_line(unbuffered):
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run(
            [sys.executable, "-m", "ema_cli", "effects", "--json"], stdout=full,
            stderr=subprocess.PIPE, text=True, check=False,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "free some disk space" in done.stderr


@pytest.mark.slow
def test_ctrl_c_in_the_middle_is_one_line(tmp_path):
    """A long simulation is stopped; no bag and no half bag stays."""
    profile = tmp_path / "long.yaml"
    points = [[0.0, -0.1]] + [[0.5 * k, 0.1 * (-1) ** k] for k in range(1, 119)]
    profile.write_text(f"name: long\npoints: {points}\n", encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "ema_cli", "simulate", "--profile", str(profile), "--rate",
         "100000", "--out", str(tmp_path / "bag")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )
    try:
        _wait_for_memory(process.pid, 400)  # of 470 MB of samples and what is imported
        os.kill(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=120)
    finally:
        process.kill()
    assert (process.returncode, out, err) == (130, "", "ema: interrupted\n")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["long.yaml"]


def _wait_for_memory(pid, megabytes):
    """Wait until the process has filled so much memory: it is at work."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        text = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
        if int(re.search(r"VmRSS:\s+(\d+) kB", text)[1]) > 1000 * megabytes:
            return
        time.sleep(0.02)
    raise AssertionError(f"process {pid} never took {megabytes} MB")


def test_a_command_that_is_not_there_is_one_line(capsys, monkeypatch):
    monkeypatch.setattr(main, "COMMANDS", (*main.COMMANDS, "nowhere"))
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("ema_cli.nowhere")
    assert main.run(["nowhere"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_json_numbers_that_are_not_finite_become_null(capsys):
    console.print_json({"a": float("nan"), "b": [1, float("inf")], "c": (None, True, "é")})
    assert capsys.readouterr().out == '{"a": null, "b": [1, null], "c": [null, true, "é"]}\n'


def test_text_from_outside_steers_no_terminal_and_is_no_markup(capsys):
    hostile = "[/] [bold]x[/bold] :smile: y [rad]\x1b[2J\nHEALTHY\x9b1m\u202e\udc80"
    shown = r"[/] [bold]x[/bold] :smile: y [rad]\u001b[2J\u000aHEALTHY\u009b1m\u202e\udc80"
    console.say(hostile)
    console.note(hostile)
    console.error_line(hostile)
    console.stdout().print(console.styled(hostile, (hostile, "bold")))
    console.print_json({"name": hostile})
    captured = capsys.readouterr()
    said, styled, as_json = captured.out.splitlines()
    noted, error = captured.err.splitlines()
    assert (said, noted, styled) == (shown, shown, shown + shown)
    assert error == "ema: " + shown.replace(r"\u000a", " ")
    assert json.loads(as_json) == {"name": hostile}
    assert as_json.isprintable()


def test_lines_are_whole_where_there_is_no_terminal(capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    line = "word " * 400 + "end"
    console.stdout().print(line)
    assert capsys.readouterr().out == line + "\n"


def test_a_terminal_shows_no_raw_markdown(capsys, monkeypatch, repository):
    text = (repository / "config/validation.md").read_text(encoding="utf-8")
    print_report(text)
    assert capsys.readouterr().out == text + "\n"
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    print_report(text)
    shown = capsys.readouterr().out
    assert "right class" in shown
    assert not re.search(r"^#|\|---|^\|", shown, re.MULTILINE)


def test_what_cannot_be_written_is_known_before(tmp_path):
    taken = tmp_path / "taken"
    taken.touch()
    for bad in (taken, taken / "below", Path("/proc/none"), tmp_path / ("n" * 250)):
        with pytest.raises(OutputError):
            console.check_new_file(bad)
        with pytest.raises(OutputError):
            console.check_new(bad)
    with pytest.raises(OutputError):
        console.check_new_file(tmp_path / "no folder" / "file")
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").touch()
    with pytest.raises(OutputError, match="would lie inside a bag"):
        console.check_new(tmp_path / "bag" / "another")
    shutil.rmtree(tmp_path / "bag")
    with pytest.raises(OutputError, match="begins with a dot is hidden"):
        console.check_new(tmp_path / ".hidden", bag=True)
    console.check_new(tmp_path / ".hidden")
    console.check_new(tmp_path / "no folder" / "folder")
    console.check_new_file(tmp_path / "file", None)
    assert list(tmp_path.iterdir()) == [taken]


@pytest.mark.parametrize(("bag", "status"), [("sim_0000_step", 0), ("sim_0001_step", 1)])
def test_a_closed_output_is_no_error(bag, status, repository):
    command = f"exec '{sys.executable}' -m ema_cli check '{repository / 'bags' / bag}' >&-"
    done = subprocess.run(["bash", "-c", command], stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (status, "")


@pytest.mark.parametrize("columns", ["0", "-5", "abc", "999999999"])
def test_a_width_that_is_none_is_not_followed(columns):
    done = subprocess.run(
        [sys.executable, "-m", "ema_cli", "--help"], env=os.environ | {"COLUMNS": columns},
        stdout=subprocess.PIPE, text=True, check=False, timeout=60)
    assert "ema check" in done.stdout
    assert all(len(line) < 200 for line in done.stdout.splitlines())
