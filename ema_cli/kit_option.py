"""`--kit DIR`, of every command: the kit of one type of actuator, while the command runs."""

from __future__ import annotations

import functools
import inspect
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from ema_record.kit import ENVIRONMENT, using_kit

NAME = "kit"
_OPTION = Annotated[Path | None, typer.Option(
    f"--{NAME}", metavar="DIR", show_default=f"${ENVIRONMENT}, or the default actuator's",
    help="Kit of the type of actuator: its description, tests, trained networks.",
)]


def with_kit(command: Callable[..., object]) -> Callable[..., object]:
    """Return `command` with the option `--kit`, which its own body finds as the present kit.

    A command that has a parameter of that name is returned as it is.
    """
    signature = inspect.signature(command)
    if NAME in signature.parameters:
        return command

    @functools.wraps(command)
    def run(*args: object, **options: object) -> object:
        kit = options.pop(NAME, None)
        if kit is None:
            return command(*args, **options)
        with using_kit(typing.cast("Path", kit)):
            return command(*args, **options)

    hints = typing.get_type_hints(command, include_extras=True)
    parameters = [p.replace(annotation=hints[p.name]) for p in signature.parameters.values()]
    own = inspect.Parameter(NAME, inspect.Parameter.KEYWORD_ONLY, default=None,
                            annotation=_OPTION)
    run.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*parameters, own], return_annotation=hints["return"])
    run.__annotations__ = {**hints, NAME: _OPTION}
    return run
