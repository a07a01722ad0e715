"""The `ema` command: which commands there are, and how one is found and run.

A command is a function with typer options in a module of its own, which imports what is heavy
when it is called. Its docstring is its help: a summary, what else to know, and an example. Each
has the common options of `ema_cli.options`.
"""

from __future__ import annotations

import functools
import gc
import importlib
import inspect
import keyword
import os
import re
import sys
import typing
from collections.abc import Callable, Sequence
from io import FileIO, TextIOWrapper
from shutil import get_terminal_size
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from ema_cli.console import WRONG_USE, error_line, say, stdout, styled
from ema_cli.ending import end_quietly, guarded, leave
from ema_cli.options import with_common
from ema_record.errors import UsageError, unknown_name

COMMANDS = ("bit", "conformance", "simulate", "check", "explain", "trend", "fleet", "report",
            "replay", "import", "export", "info", "lint", "recover", "identify", "effects",
            "profile", "new-actuator", "commission", "train", "paper", "completion", "man")
"""All commands, in the order of the help."""
PROGRAM = "ema"
FRAMED = 80
"""Least width of a help in frames (characters); narrower they would cut names of options."""
PURPOSE = "built-in test and diagnosis of electromechanical actuators"
EXIT_STATUS = (
    "0 healthy or done, 1 a fault, 2 wrong use or unreadable input, 3 unknown or incomplete, "
    "4 no verdict of ema bit, 70 an error in this software, 130 interrupted, 143 terminated")
WIDTHS = r"[1-9]\d{1,3}"
"""What `$COLUMNS` is followed in: 10 to 9999 characters."""
OBJECTS = 50_000
"""New objects after which circles among them are looked for; a start makes many, and no circle."""

TYPES = {"bool": None, "int": "NUMBER", "float": "NUMBER", "Path": "FILE", "list[Path]": "FILE"}
"""How values are shown in the help, by their types; others are a TEXT."""


class Command(TyperCommand):
    """One command; its help says what a value is as a person calls it."""

    def get_params(self, ctx: Any) -> Any:
        """Return all parameters."""
        params = super().get_params(ctx)
        for param in params:
            if hasattr(param, "bare_type"):  # a typer that shows Python's types
                argument = param.param_type_name == "argument"
                shown = None if argument else param.metavar or TYPES.get(
                    param.bare_type(), "TEXT")
                typing.cast("Any", param).display_type_rich = functools.partial(_shown, shown)
        return params

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the usage without the brackets that typer puts around our names of values."""
        pieces = super().collect_usage_pieces(ctx)
        plain = [re.sub(r"^\{(.+?)(\.\.\.)?\}(\.\.\.)?$", r"\1\3", piece) for piece in pieces]
        return [re.sub(r"^\[\[(.+)\]\](\.\.\.)?$", r"[\1]\2", piece) for piece in plain]


def _shown(text: str | None, ctx: Any) -> str | None:  # noqa: ARG001  (typer's signature)
    return text


class Commands(TyperGroup):
    """All commands; each is imported when it is called."""

    def get_command(self, _ctx: Any, cmd_name: str) -> Any:
        """Return one command, ready to read its options."""
        if cmd_name not in COMMANDS:
            raise unknown_name("command", cmd_name, COMMANDS, f"'{PROGRAM} --help' lists them")
        return get_command(build_app(cmd_name))


app = typer.Typer(cls=Commands, add_completion=False)


@app.callback(invoke_without_command=True, context_settings={"help_option_names": []})
def ema(
    context: typer.Context,
    show_help: Annotated[bool, typer.Option("--help", "-h")] = False,
    version: Annotated[bool, typer.Option("--version", "-V")] = False,
) -> int:
    """Say what can be done, or the version; without a command it is wrong use."""
    from ema_record.version import VERSION

    if version:
        say(f"{PROGRAM} {VERSION}")
    elif show_help or context.invoked_subcommand is None:
        _print_help()
    if version or show_help:
        raise typer.Exit
    return WRONG_USE


def main() -> None:
    """Run `ema` on the arguments of the process and exit."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever started it
            setattr(sys, name, TextIOWrapper(FileIO(os.devnull, "w"), encoding="utf-8"))
    if not re.fullmatch(WIDTHS, os.environ.get("COLUMNS", "")):
        os.environ.pop("COLUMNS", None)
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    end_quietly()
    gc.set_threshold(OBJECTS)
    leave(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run `ema` on `arguments` and return the exit status; errors become one line."""
    return guarded(lambda: _run(list(arguments)))


def _run(arguments: list[str]) -> int:
    if any(not a or re.fullmatch(r"--[\w-]+=", a) for a in arguments):
        raise UsageError("an argument is empty: give it a value (a shell variable that is not "
                         "set?)")
    if arguments[:1] == ["help"]:
        arguments = [*arguments[1:2], "--help"]
    group = get_command(app)
    try:
        # Not group.main: it has its own opinion of closed pipes and of Ctrl-C.
        with group.make_context(PROGRAM, arguments) as context:
            status = group.invoke(context)
    except typer.Exit as leaving:
        return leaving.exit_code
    except typer.Abort:
        raise KeyboardInterrupt from None
    except Exception as error:
        if not hasattr(error, "format_message"):  # typer's own, of whatever version
            raise
        error_line(_describe(error, arguments))
        return WRONG_USE
    return status if isinstance(status, int) else 0


def _describe(error: Any, arguments: Sequence[str]) -> str:
    """Return what typer has to say about wrong options, with the nearest option."""
    near, context = getattr(error, "possibilities", None), getattr(error, "ctx", None)
    text = (f"no such option {error.option_name!r}: did you mean {near[0]!r}?" if near
            else f"{_wrong_value(error)};")
    if type(error).__name__ == "NoSuchOption" and not near and context and not context.parent:
        text = (f"no option {error.option_name!r} before the command: options follow it, "
                f"'{PROGRAM} COMMAND {error.option_name} ...';")
    given = " ".join([PROGRAM, *(name for name in arguments[:1] if name in COMMANDS)])
    return f"{text} see '{given if context is None else context.command_path} --help'"


def _wrong_value(error: Any) -> str:
    """Return what is wrong with a value, in words of ours where typer has pydantic's."""
    problems = error.__context__.errors() if hasattr(error.__context__, "errors") else []
    if not problems:
        return str(error.format_message()).rstrip(". ")
    kind, value = problems[0]["type"], str(problems[0]["input"])[:60]
    if kind.startswith(("int", "float", "greater", "less")):
        least, most = (getattr(error.param, name, None) for name in ("min", "max"))
        error.message = ("expected a whole number" if kind.startswith("int") else
                         "expected a number")
        if least is not None:
            error.message += f" from {least}" + (" on" if most is None else f" to {most}")
    return f"{error.format_message().rstrip('. ')} (value {value})"


def load_command(name: str) -> Callable[..., object]:
    """Import a command; its module and function have its name as Python can write it.

    ``import_`` for ``import``, ``new_actuator`` for ``new-actuator``.
    """
    name = name.replace("-", "_") + ("_" if keyword.iskeyword(name) else "")
    function: Callable[..., object] = getattr(
        importlib.import_module(f"ema_cli.commands.{name}"), name)
    return function


def build_app(name: str) -> typer.Typer:
    """Return a typer application of one command, its docstring as help, with common options."""
    function = load_command(name)
    text, _, example = inspect.cleandoc(function.__doc__ or "").rpartition("\n\n")
    single = typer.Typer(
        add_completion=False, pretty_exceptions_enable=False,
        rich_markup_mode="markdown" if get_terminal_size().columns >= FRAMED else None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    single.command(name, cls=Command, help=text, epilog=example)(with_common(function))
    return single


def _print_help() -> None:
    from ema_cli.lines import wrapped

    console = stdout()
    width = max(map(len, COMMANDS)) + 2

    def text(words: str, indent: str = "") -> None:
        for line in wrapped(words, console.width - len(indent)):
            console.print(styled(indent + line), soft_wrap=True)

    text(f"{PROGRAM}: {PURPOSE}")
    console.print()
    text(f"Usage: {PROGRAM} COMMAND [OPTIONS]; {PROGRAM} COMMAND --help explains one command; "
         f"{PROGRAM} --version")
    console.print()
    for name in COMMANDS:
        lines = inspect.cleandoc(load_command(name).__doc__ or "").splitlines()
        for k, line in enumerate(wrapped(lines[0], console.width - width)):
            first = (name.ljust(width), "bold") if k == 0 else " " * width
            console.print(styled(first, line), soft_wrap=True)
        # An example is one line on every terminal: it is there to be copied.
        console.print(styled(" " * width, (lines[-1].split("`")[1], "dim")), soft_wrap=True)
    console.print()
    text("Each takes --kit DIR (or $EMA_KIT): the kit of another type of actuator than the "
         "default one; --lang, --color, -v and -q")
    console.print()
    text(f"Exit status: {EXIT_STATUS}")
