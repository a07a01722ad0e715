"""The `ema` command: which commands there are, and how one is found and run.

A command is a function with typer options in a module of its own; the module is imported
when the command is called, so that help and the light commands start at once.
"""

from __future__ import annotations

import importlib
import inspect
import keyword
import re
import sys
from collections.abc import Callable, Sequence
from io import TextIOWrapper
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperGroup
from typer.main import get_command

from ema_cli.console import WRONG_USE, error_line, guarded, leave, print_table, say, stdout, styled
from ema_record.errors import UsageError, unknown_name


class Command(NamedTuple):
    """One command: its module and function have its name (``import_`` for ``import``)."""

    name: str
    summary: str
    example: str


COMMANDS: dict[str, Command] = {
    command.name: command
    for command in (
        Command("bit", "Run the whole built-in test over ROS 2 and print the verdict.",
                "ema bit --effect turn_short.fraction=0.1 --effect turn_short.phase=b"),
        Command("simulate", "Run a test on the emulated actuator, without ROS, into a bag.",
                "ema simulate --profile step --effect turn_short.fraction=0.1 --out short"),
        Command("check", "Say what is wrong with the actuator that a bag was recorded from.",
                "ema check bags/sim_0001_extended"),
        Command("trend", "Say how the faults of an actuator grow from flight to flight.",
                "ema trend flights/SN-0007 --plot growth.png"),
        Command("replay", "Put a bag back onto the topics.",
                "ema replay bags/sim_0001_extended"),
        Command("import", "Convert a file of a rig (CSV, MAT, NPZ) to a bag, by a map of it.",
                "ema import run.csv --map rig.yaml --out run"),
        Command("export", "Convert a bag to CSV, Parquet or messages for plotters; plot it.",
                "ema export bags/sim_0000_step --format csv --out healthy.csv"),
        Command("lint", "Look for defects of a recording: gaps, swapped phases, wrong units.",
                "ema lint bags/sim_0001_extended --json"),
        Command("recover", "Rebuild a readable bag from a recording that was cut or damaged.",
                "ema recover SN-1_20260101T120000Z_extended --out recovered"),
        Command("identify", "Say what a model lacks to explain records, and add it.",
                "ema identify bags/sim_0004_extended --validate bags/sim_0004_step --out report"),
        Command("effects", "List the catalogue of physical effects, or explain one.",
                "ema effects turn_short"),
        Command("train", "Train the cascade of networks and write its model file.",
                "ema train --out model.json"),
        Command("paper", "Repeat the paper's experiment, its numbers beside ours.",
                "ema paper --json"),
    )
}
"""All commands, in the order of the help."""

PROGRAM = "ema"


class Commands(TyperGroup):
    """All commands; each is imported when it is called."""

    def get_command(self, _ctx: Any, cmd_name: str) -> Any:
        """Return one command, ready to read its options."""
        if cmd_name not in COMMANDS:
            raise unknown_name("command", cmd_name, COMMANDS, f"'{PROGRAM} --help' lists them")
        return get_command(build_app(COMMANDS[cmd_name]))


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
            else error.format_message().rstrip(". ") + ";")
    context = getattr(error, "ctx", None)
    return f"{text} see '{PROGRAM if context is None else context.command_path} --help'"


def build_app(command: Command) -> typer.Typer:
    """Import a command and return a typer application of it, its help with an example."""
    name = f"{command.name}_" if keyword.iskeyword(command.name) else command.name
    module = importlib.import_module(f"ema_cli.commands.{name}")
    function: Callable[..., object] = getattr(module, name)
    details = inspect.cleandoc(function.__doc__ or "").partition("\n\n")[2]
    single = typer.Typer(
        add_completion=False, rich_markup_mode="markdown", pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    single.command(
        command.name, help=f"{command.summary}\n\n{details}",
        epilog=f"Example: `{command.example}`",
    )(function)
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
    for command in COMMANDS.values():
        table.add_row(command.name, command.summary)
        table.add_row("", styled((command.example, "dim")))
    print_table(table)
    console.print(
        "\nExit status: 0 healthy or done, 1 a fault, 2 wrong use or unreadable input, "
        "3 unknown or incomplete, 70 an error in this software, 130 interrupted"
    )
