"""Options that several commands share, and those that each command has.

Each has ``--kit DIR``, ``--lang``, ``--color``, ``-v`` and ``-q``; `with_common` gives them to it.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import os
import signal
import typing
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Annotated

import typer

from ema_cli import console
from ema_record.errors import UsageError, unknown_name
from ema_record.kit import ENVIRONMENT, using_kit
from ema_record.limits import MAX_TEXT
from ema_ros.process import LAST_DOMAIN

Bags = Annotated[list[Path], typer.Argument(
    metavar="BAG...", help="Bag directories or .mcap files; or a directory of them.")]
ObjectABag = Annotated[bool, typer.Option("--json", help="Print one JSON object a bag.")]
Domain = Annotated[int | None, typer.Option(
    "--domain", min=0, max=LAST_DOMAIN, help="ROS domain, default ROS_DOMAIN_ID.")]
Commanded = Annotated[str | None, typer.Option(
    "--profile", "-p", metavar="NAME|FILE.yaml",
    help="The test that was commanded, in place of a bag's own.")]
Cascade = Annotated[Path | None, typer.Option(
    "--model", metavar="FILE.json", help="Model file of 'ema train', in place of the kit's.")]
Baseline = Annotated[Path | None, typer.Option(
    "--baseline", metavar="BAG", help="A healthy bag of the same actuator and test, from its "
    "acceptance: sharpens a verdict.")]
Effect = Annotated[list[str] | None, typer.Option(
    "--effect", "-e", metavar="NAME.PARAMETER=VALUE",
    help="Effect to hide in the simulated actuator; repeatable. 'ema effects' lists them.")]
Changes = Annotated[Path | None, typer.Option(
    "--model", metavar="FILE.yaml",
    help="Actuator parameters and effects: changes over the kit's.")]
Seed = Annotated[int, typer.Option(
    "--seed", min=0, max=2**31 - 1, help="Of noise and start angle; same seed, same samples.")]
Noise = Annotated[float, typer.Option("--noise", help="Factor on the sensor noise, 0 for none.")]
Rule = Annotated[str, typer.Option(
    metavar="K/N", help="A fault is confirmed when K of the last N flights find it.")]
Format = Annotated[str, typer.Option(
    "--format", metavar="text|json|csv", help="json: one object a line, see docs/api.md; csv: a "
    "row a fault, with a header.")]


def one_line(parameter: typer.CallbackParam, text: str) -> str:
    """Return what an option says, in one line that can be printed."""
    if len(text) > MAX_TEXT or not text.isprintable():
        raise UsageError(f"{parameter.opts[0]} {text[:40]!r}: expected at most {MAX_TEXT} "
                         f"characters that can be printed (given: {len(text)})")
    return text


SerialNumber = Annotated[str, typer.Option(
    "--serial-number", metavar="TEXT", callback=one_line, help="Of the actuator.")]
TrainingJobs = Annotated[int, typer.Option(
    "--jobs", min=-1, max=256, help="Processes that simulate, -1 for all cores.")]

_PANEL = "Common options"
COLORS = {"auto": {}, "always": {"FORCE_COLOR": "1"}, "never": {"NO_COLOR": "1"}}
"""What each choice of ``--color`` sets in the environment."""
COMMON: dict[str, object] = {
    "kit": Annotated[Path | None, typer.Option(
        "--kit", metavar="DIR", show_default=f"${ENVIRONMENT}, or the default actuator's",
        rich_help_panel=_PANEL,
        help="Kit of the type of actuator: its description, tests, trained networks.")],
    "lang": Annotated[str | None, typer.Option(
        "--lang", metavar="NAME|FILE.yaml", show_default="$EMA_LANG, or en",
        rich_help_panel=_PANEL, help="Language of what a person reads: en, de.")],
    "color": Annotated[str | None, typer.Option(
        "--color", metavar="auto|always|never", show_default="auto", rich_help_panel=_PANEL,
        help="Colours; auto: on a terminal.")],
    "verbose": Annotated[bool, typer.Option(
        "--verbose", "-v", rich_help_panel=_PANEL, help="Also the numbers.")],
    "quiet": Annotated[bool, typer.Option(
        "--quiet", "-q", rich_help_panel=_PANEL, help="Results in short; no progress, no notes.")],
}
"""The options that each command has."""


def given_once(option: str, settings: Iterable[str] | None) -> None:
    """Raise UsageError where a name stands twice among the NAME=VALUE of an option."""
    seen: dict[str, str] = {}
    for setting in settings or ():
        name, _, value = (part.strip() for part in setting.partition("="))
        if name in seen:
            raise UsageError(f"{option} {name}: given twice, as {seen[name]} and as {value}: give "
                             "it once")
        seen[name] = value


def with_common(command: Callable[..., object]) -> Callable[..., object]:
    """Return `command` with the options of `COMMON`, in force while it runs.

    One that it has itself is left to it.
    """
    signature = inspect.signature(command)
    added = {name: kind for name, kind in COMMON.items() if name not in signature.parameters}

    @functools.wraps(command)
    def run(*args: object, **options: object) -> object:
        common = {name: options.pop(name, None) for name in added}
        with _in_force(common):
            signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))
            return command(*args, **options)

    hints = inspect.get_annotations(command, eval_str=True)  # no Optional about it, as 3.10 puts
    parameters = [p.replace(annotation=hints[p.name]) for p in signature.parameters.values()]
    own = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=kind,
                          default=False if name in ("verbose", "quiet") else None)
        for name, kind in added.items()
    ]
    run.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*parameters, *own], return_annotation=hints["return"])
    run.__annotations__ = {**hints, **added}
    return run


@contextlib.contextmanager
def _in_force(common: dict[str, object]) -> Iterator[None]:
    """Work with the common options that are given."""
    setting: dict[str, str] = {}
    color = common.get("color")
    if color is not None:
        if color not in COLORS:
            raise unknown_name("colour", str(color), COLORS, f"give one of {', '.join(COLORS)}")
        setting |= COLORS[str(color)]
    if common.get("lang") is not None:
        from ema_prognostics.words import ENVIRONMENT as LANGUAGE
        from ema_prognostics.words import words

        setting[LANGUAGE] = str(common["lang"])
        words(setting[LANGUAGE])
    with contextlib.ExitStack() as stack:
        stack.enter_context(_environment(setting))
        stack.enter_context(console.speaking(
            verbose=bool(common.get("verbose")), quiet=bool(common.get("quiet"))))
        if common.get("kit") is not None:
            stack.enter_context(using_kit(typing.cast("Path", common["kit"])))
        yield


@contextlib.contextmanager
def _environment(setting: dict[str, str]) -> Iterator[None]:
    """Set variables of the environment, of children too, inside a ``with`` block."""
    before = {name: os.environ.get(name) for name in setting}
    os.environ.update(setting)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value
