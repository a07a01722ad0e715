"""The `ema` command: which commands there are, and how one is found and run.

A command is a function with typer options in a module of its own, which imports what is heavy
when it is called. Its docstring is its help: a summary, what else to know, and an example. Each
has `--kit DIR`: the kit of one type of actuator, while the command runs.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import keyword
import re
import sys
import typing
from collections.abc import Callable, Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from ema_cli.console import WRONG_USE, error_line, guarded, leave, print_table, say, stdout, styled
from ema_record.errors import UsageError, unknown_name
from ema_record.kit import ENVIRONMENT, using_kit

COMMANDS = ("bit", "conformance", "simulate", "check", "trend", "fleet", "replay", "import",
            "export", "lint", "recover", "identify", "effects", "profile", "new-actuator",
            "commission", "train", "paper")
"""All commands, in the order of the help."""
PROGRAM = "ema"
KIT = "kit"
_KIT_OPTION = Annotated[Path | None, typer.Option(
    f"--{KIT}", metavar="DIR", show_default=f"${ENVIRONMENT}, or the default actuator's",
    help="Kit of the type of actuator: its description, tests, trained networks.",
)]


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
    version: Annotated[bool, typer.Option("--version")] = False,
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
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
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
        error_line(_describe(error))
        return WRONG_USE
    return status if isinstance(status, int) else 0


def _describe(error: Any) -> str:
    """Return what typer has to say about wrong options, with the nearest option."""
    near = getattr(error, "possibilities", None)
    text = (f"no such option {error.option_name!r}: did you mean {near[0]!r}?" if near
            else f"{error.format_message().rstrip('. ')}{_value(error.__context__)};")
    context = getattr(error, "ctx", None)
    return f"{text} see '{PROGRAM if context is None else context.command_path} --help'"


def _value(cause: Any) -> str:
    """Return the value that was given, which not all versions of typer say."""
    problems = cause.errors() if hasattr(cause, "errors") else []
    return f" (value {str(problems[0]['input'])[:60]})" if problems else ""


def load_command(name: str) -> Callable[..., object]:
    """Import a command; its module and function have its name as Python can write it.

    ``import_`` for ``import``, ``new_actuator`` for ``new-actuator``.
    """
    name = name.replace("-", "_") + ("_" if keyword.iskeyword(name) else "")
    function: Callable[..., object] = getattr(
        importlib.import_module(f"ema_cli.commands.{name}"), name)
    return function


def with_kit(command: Callable[..., object]) -> Callable[..., object]:
    """Return `command` with the option `--kit`, which its own body finds as the present kit.

    A command that has a parameter of that name is returned as it is.
    """
    signature = inspect.signature(command)
    if KIT in signature.parameters:
        return command

    @functools.wraps(command)
    def run(*args: object, **options: object) -> object:
        kit = options.pop(KIT, None)
        if kit is None:
            return command(*args, **options)
        with using_kit(typing.cast("Path", kit)):
            return command(*args, **options)

    hints = typing.get_type_hints(command, include_extras=True)
    parameters = [p.replace(annotation=hints[p.name]) for p in signature.parameters.values()]
    own = inspect.Parameter(KIT, inspect.Parameter.KEYWORD_ONLY, default=None,
                            annotation=_KIT_OPTION)
    run.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*parameters, own], return_annotation=hints["return"])
    run.__annotations__ = {**hints, KIT: _KIT_OPTION}
    return run


def build_app(name: str) -> typer.Typer:
    """Return a typer application of one command, with its docstring as help and `--kit`."""
    function = load_command(name)
    text, _, example = inspect.cleandoc(function.__doc__ or "").rpartition("\n\n")
    single = typer.Typer(
        add_completion=False, rich_markup_mode="markdown", pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    single.command(name, help=text, epilog=example)(with_kit(function))
    return single


def _print_help() -> None:
    from rich.table import Table

    console = stdout()
    console.print(
        styled((PROGRAM, "bold"), ": built-in test and diagnosis of electromechanical actuators")
    )
    console.print(
        f"\nUsage: {PROGRAM} COMMAND [OPTIONS] ; {PROGRAM} COMMAND --help explains one command; "
        f"{PROGRAM} --version\n"
    )
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name in COMMANDS:
        lines = inspect.cleandoc(load_command(name).__doc__ or "").splitlines()
        table.add_row(name, lines[0])
        table.add_row("", styled((lines[-1].split("`")[1], "dim")))
    print_table(table)
    console.print(
        "\nEach takes --kit DIR (or $EMA_KIT): the kit of another type of actuator than the "
        "default one"
    )
    console.print(
        "\nExit status: 0 healthy or done, 1 a fault, 2 wrong use or unreadable input, "
        "3 unknown or incomplete, 4 no verdict of ema bit, 70 an error in this software, "
        "130 interrupted"
    )
