"""The pages of the manual say what the help says, as a program for man pages reads them."""

import re
import shutil
import subprocess

import pytest
from typer.main import get_command

from ema_cli.commands.man import _text, page
from ema_cli.main import COMMANDS, build_app, run
from ema_cli.options import COMMON

SECTIONS = ["NAME", "SYNOPSIS", "DESCRIPTION", "OPTIONS", "EXIT STATUS", "EXAMPLE", "SEE ALSO"]


def read(text):
    """Return what a page says, without the escapes of roff."""
    plain = re.sub(r"\\f[BIRP]|\\&", "", text)
    return plain.replace(r"\-", "-").replace(r"\e", "\\")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_a_page_that_says_what_its_help_says(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert run([command, "--help"]) == 0
    helped = capsys.readouterr().out
    text = page(command)
    said = read(text)
    assert re.findall(r"^\.SH (.+)$", text, re.MULTILINE) == SECTIONS
    options = set(re.findall(r"(?<![\w-])--[a-z][\w-]+", helped)) - {"--help"}
    assert options
    assert [o for o in options if not re.search(rf"^{o}\b|, {o}\b", said, re.MULTILINE)] == []
    example = said.partition(".SH EXAMPLE\n.nf\n")[2].splitlines()[0]
    assert example.startswith(f"ema {command}") and example in " ".join(helped.split())


def options_of(command):
    """Return the options of a command that not all have, in the order of its help."""
    params = get_command(build_app(command)).params
    return [next(o for o in p.opts if o.startswith("--")) for p in params
            if p.param_type_name == "option" and p.name not in COMMON]


def test_the_document_names_every_option(repository):
    text = (repository / "docs" / "commands.md").read_text(encoding="utf-8")
    rows = text.partition("## Options")[2].partition("\n## ")[0]
    assert [f"| `ema {c}` | {' '.join(f'`{o}`' for o in options_of(c)) or 'none'} |"
            for c in COMMANDS] == re.findall(r"^\| `ema .*$", rows, re.MULTILINE)
    assert [name for name in COMMON if f"`--{name}" not in rows] == []


def test_all_and_one_and_no_command(tmp_path, capsys):
    assert run(["man"]) == 0
    everything = read(capsys.readouterr().out)
    assert [c for c in COMMANDS if f"\n.TP\n{c}\n" not in everything] == []
    assert run(["man", "chekc"]) == 2
    assert "did you mean 'check'" in capsys.readouterr().err
    folder = tmp_path / "man1"
    assert run(["man", "--out", str(folder)]) == 0
    assert {p.name for p in folder.iterdir()} == {"ema.1", *(f"ema-{c}.1" for c in COMMANDS)}
    assert (folder / "ema-check.1").read_text(encoding="utf-8") == page("check")
    assert run(["man", "--out", str(folder)]) == 2  # nothing is overwritten
    assert capsys.readouterr().err.count("\n") == 1


def test_nothing_in_a_text_is_a_request():
    assert _text(".sp 9") == r"\&.sp 9"
    assert _text(r"a\b 'c") == r"a\eb 'c"


@pytest.mark.skipif(shutil.which("groff") is None, reason="no groff: pages are NOT typeset")
def test_man_shows_it_without_a_warning():
    for command in ("", "check", "simulate", "import"):
        done = subprocess.run(
            ["groff", "-man", "-Tutf8", "-ww", "-K", "utf8"], input=page(command),
            capture_output=True, text=True, check=True)
        assert done.stderr == ""
        assert "EXIT STATUS" in re.sub(r"\x1b\[[\d;]*m|.\x08", "", done.stdout)
