"""The `ema` command: which commands there are, and how one is found and run.

A command is a function with typer options in a module of its own; the module is imported
when the command is called, so that help and the light commands start at once.
"""

from __future__ import annotations

import importlib
import keyword
import re
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple, cast

from ema_cli.console import WRONG_USE, error_line, guarded, leave
from ema_record.errors import unknown_name

if TYPE_CHECKING:
    import typer


class Command(NamedTuple):
    """One command: its module and function have its name (``import_`` for ``import``)."""

    name: str
    summary: str
    example: str

    def load(self) -> Callable[..., object]:
        """Import the function of this command."""
        name = f"{self.name}_" if keyword.iskeyword(self.name) else self.name
        module = importlib.import_module(f"ema_cli.commands.{name}")
        function: Callable[..., object] = getattr(module, name)
        return function


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
HELP = ("-h", "--help")
OPTIONS = (*HELP, "--version")
SECTION = re.compile(r"\n[ \t]*\w[\w ]*\n[ \t]*---+[ \t]*\n")
"""Underlined title of a section of a numpy docstring."""


def main() -> None:
    """Run `ema` on the arguments of the process and exit."""
    leave(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run `ema` on `arguments` and return the exit status; errors become one line."""
    return guarded(lambda: _dispatch(list(arguments)))


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0] in HELP:
        _print_help()
        return 0 if arguments else WRONG_USE
    name, *rest = arguments
    if name == "--version":
        from ema_record.version import VERSION

        print(f"{PROGRAM} {VERSION}")
        return 0
    if name.startswith("-"):
        raise unknown_name("option", name, OPTIONS, f"'{PROGRAM} --help' lists the commands")
    if name == "help":
        name, rest = (rest[0], ["--help"]) if rest else ("--help", [])
        return _dispatch([name, *rest])
    if name not in COMMANDS:
        raise unknown_name("command", name, COMMANDS, f"'{PROGRAM} --help' lists them")
    return _run_command(COMMANDS[name], rest)


def _run_command(command: Command, arguments: list[str]) -> int:
    """Let typer read the options of one command, and call it."""
    import typer
    from typer.main import get_command

    _, usage_error, click_exception = cast(
        "tuple[type[Exception], ...]", typer.BadParameter.__mro__[:3]
    )
    parser = get_command(build_app(command))
    try:
        # Not parser.main: it has its own opinion of closed pipes and of Ctrl-C.
        with parser.make_context(f"{PROGRAM} {command.name}", arguments) as context:
            status = parser.invoke(context)
    except typer.Exit as leaving:
        return leaving.exit_code
    except typer.Abort:
        raise KeyboardInterrupt from None
    except click_exception as error:
        hint = f"; see '{PROGRAM} {command.name} --help'"
        error_line(_describe(error) + (hint if isinstance(error, usage_error) else ""))
        return WRONG_USE
    return status if isinstance(status, int) else 0


def _describe(error: Exception) -> str:
    """Return what typer has to say about wrong options, with the nearest option."""
    near = getattr(error, "possibilities", None)
    if near:
        name = getattr(error, "option_name", "")
        return f"no such option {name!r}: did you mean {near[0]!r}"
    message: str = error.format_message()  # type: ignore[attr-defined]
    return message.rstrip(". ")


def build_app(command: Command) -> typer.Typer:
    """Return a typer application of one command, its help with an example."""
    import typer

    function = command.load()
    app = typer.Typer(
        add_completion=False, rich_markup_mode="markdown", pretty_exceptions_enable=False,
        context_settings={"help_option_names": list(HELP)},
    )
    app.command(
        command.name, help=_help_text(command, function), epilog=f"Example: `{command.example}`"
    )(function)
    return app


def _help_text(command: Command, function: Callable[..., object]) -> str:
    """Return the documentation of a command without the sections for programmers."""
    text = SECTION.split(function.__doc__ or "")[0].strip()
    paragraphs = [" ".join(part.split()) for part in re.split(r"\n\s*\n", text)[1:]]
    kept = (part for part in paragraphs if part and not part.startswith("Example:"))
    return "\n\n".join([command.summary, *kept])


def _print_help() -> None:
    from rich.table import Table

    from ema_cli.console import stdout

    console = stdout()
    console.print(
        f"[bold]{PROGRAM}[/bold]: built-in test and diagnosis of electromechanical actuators\n\n"
        f"Usage: {PROGRAM} COMMAND [OPTIONS] ; {PROGRAM} COMMAND --help explains one command; "
        f"{PROGRAM} --version\n"
    )
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for command in COMMANDS.values():
        table.add_row(command.name, f"{command.summary}\n[dim]{command.example}[/dim]")
    console.print(table)
    console.print(
        "\nExit status: 0 healthy or done, 1 a fault, 2 wrong use or unreadable input, "
        "3 unknown or incomplete, 70 an error in this software, 130 interrupted"
    )
