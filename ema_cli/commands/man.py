"""`ema man`: the pages of the manual, from the help of the commands."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from ema_cli.console import check_new_file, say
from ema_cli.lines import say_lines
from ema_record.errors import unknown_name
from ema_record.version import VERSION

SUFFIX = ".1"


def man(
    command: Annotated[str, typer.Argument(
        metavar="[COMMAND]", help="Whose page; without it that of ema itself.")] = "",
    out: Annotated[Path | None, typer.Option(
        "--out", "-o", metavar="DIR", help="Write the pages of all commands, ema.1 and "
        "ema-COMMAND.1, into this folder instead.")] = None,
) -> int:
    """Print a page of the manual, or write all of them.

    To read one: ema man check | man -l -. To keep them: ema man --out ~/.local/share/man/man1,
    then man ema-check. 'make bit' has done so for the environment that it makes.

    Example: `ema man check`
    """
    from ema_cli.main import COMMANDS

    if command and command not in COMMANDS:
        raise unknown_name("command", command, COMMANDS, "'ema --help' lists them")
    if out is None:
        say_lines(page(command))
        return 0
    from ema_record.files import cannot_write, new_file

    texts = {out / f"{title(name)}{SUFFIX}": page(name) for name in ("", *COMMANDS)}
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(out, error) from None
    check_new_file(*texts)
    for file, text in texts.items():
        with new_file(file) as temporary:
            temporary.write_text(text, encoding="utf-8")
    say(f"{len(texts)} pages in {out}")
    return 0


def title(command: str) -> str:
    """Return the name of a page: ``ema``, ``ema-check``."""
    return f"ema-{command}" if command else "ema"


def page(command: str) -> str:
    """Return a page as roff with the macros of man(7); the same text for the same version."""
    from ema_cli.main import COMMANDS

    others = [title("")] if command else [title(name) for name in COMMANDS]
    return "\n".join([
        f'.TH "{title(command).upper()}" "1" "" "ema {VERSION}" "ema_phm"',
        *(_of_command(command) if command else _of_all()),
        ".SH SEE ALSO",
        ", ".join(rf"\fB{_text(other)}\fR(1)" for other in others), ""])


def _of_all() -> list[str]:
    from ema_cli.main import COMMANDS, EXIT_STATUS, PURPOSE

    lines = [".SH NAME", rf"ema \- {_text(PURPOSE)}", ".SH SYNOPSIS",
             r"\fBema\fR \fICOMMAND\fR [\fIOPTIONS\fR]", ".SH COMMANDS"]
    for name in COMMANDS:
        lines += [".TP", rf"\fB{_text(name)}\fR", _text(_parts(name)[0])]
    return [*lines, ".SH EXIT STATUS", _text(EXIT_STATUS)]


def _of_command(name: str) -> list[str]:
    from typer.main import get_command

    from ema_cli.main import EXIT_STATUS, build_app

    summary, *paragraphs = _parts(name)
    example = paragraphs.pop()
    params: list[Any] = list(get_command(build_app(name)).params)
    arguments = [p for p in params if p.param_type_name == "argument"]
    options = [p for p in params if p.param_type_name != "argument" and not p.hidden]
    lines = [
        ".SH NAME", rf"{_text(title(name))} \- {_text(summary.rstrip('.'))}", ".SH SYNOPSIS",
        " ".join([rf"\fBema {_text(name)}\fR", *(rf"\fI{_text(_value(p))}\fR" for p in arguments),
                  r"[\fIOPTIONS\fR]"]),
        ".SH DESCRIPTION", _text(summary)]
    for paragraph in paragraphs:
        lines += [".PP", _text(paragraph)]
    lines += [".SH OPTIONS"]
    for param in (*arguments, *options):
        names = ", ".join(rf"\fB{_text(one)}\fR" for one in (*param.opts, *param.secondary_opts)
                          if one.startswith("-"))
        lines += [".TP", " ".join(filter(None, [names, rf"\fI{_text(_value(param))}\fR"
                                                if _value(param) else ""])),
                  _text(f"{param.help or ''}{_default(param)}")]
    return [*lines, ".SH EXIT STATUS", _text(EXIT_STATUS),
            ".SH EXAMPLE", ".nf", _text(example.split("`")[1]), ".fi"]


def _parts(name: str) -> list[str]:
    """Return the paragraphs of a command's docstring, each in one line, the example last."""
    import inspect

    from ema_cli.main import load_command

    text = inspect.cleandoc(load_command(name).__doc__ or "")
    return [" ".join(part.split()) for part in text.split("\n\n")]


def _value(param: Any) -> str:
    """Return what stands for the value of an option or argument; empty: it takes none."""
    from ema_cli.main import TYPES

    if getattr(param, "is_flag", False):
        return ""
    kind = param.bare_type() if hasattr(param, "bare_type") else ""
    return str(param.metavar or TYPES.get(kind) or "TEXT")


def _default(param: Any) -> str:
    shown = param.show_default if isinstance(param.show_default, str) else param.default
    if shown in (None, False, "", True) or callable(shown) or param.required:
        return ""
    return f" [{shown}]"


def _text(words: str) -> str:
    """Return words as roff shows them: nothing in them is a request or an escape."""
    escaped = words.replace("\\", r"\e").replace("-", r"\-")
    return re.sub(r"^([.'])", r"\\&\1", escaped.replace("`", ""))
