"""Lines and rows of text that fit the terminal: wrapped within themselves, whole in a pipe.

No word, path or command is broken, and a number stays with its unit.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from ema_cli.console import neutral, say, styled

if TYPE_CHECKING:
    from rich.console import Console

INDENT = 2
GAP = 2
"""Blanks between the columns of rows."""
NARROWEST = 20
"""Least width of the last column (characters)."""
UNIT_GAP = re.compile(r"(?<=\d) (?=%|mrad|N m|A\b|rad/s|ms|°C|x\b)")
"""Between a number and its unit, where no line is broken."""
NO_BREAK = "\u00a0"
Cell = str | tuple[str, str]
"""A text, or one with a style."""


class TextLine(NamedTuple):
    """A labelled line of a verdict."""

    label: str | None
    """None: the text begins where labels do."""
    text: str
    style: str = ""
    tail: str = ""
    """What stands at the right edge, e.g. a bar."""


def say_lines(text: str) -> None:
    """Print the lines of a text as results, one by one."""
    for line in text.splitlines():
        say(line)


def print_lines(lines: Sequence[TextLine], console: Console) -> None:
    """Print labelled lines, their texts in one column that is wrapped within itself."""
    wide = max((len(line.label or "") for line in lines), default=0)
    begin = INDENT + wide + 2
    tails = max((len(line.tail) for line in lines), default=0)
    longest = max((len(neutral(line.text)) for line in lines if line.tail), default=0)
    room = console.width - begin
    beside = longest + 2 + tails <= room
    for line in lines:
        label = line.label.ljust(wide) + "  " if line.label is not None else ""
        text, tail = neutral(line.text), line.tail
        if tail and not beside:
            text, tail = f"{text}{NO_BREAK}{tail.rstrip('▇# ').strip()}", ""
        if not (label.strip() or text):
            console.print()
            continue
        for piece in wrapped(text, room if line.label is not None else console.width - INDENT):
            shown = f"{piece.ljust(longest)}  {tail}" if tail else piece
            console.print(styled((" " * INDENT + label, "bold"), (shown, line.style)),
                          soft_wrap=True)
            label, tail = " " * len(label), ""


def wrapped(text: str, width: int) -> list[str]:
    """Return the lines of a text; numbers stay with their units, words and paths are whole."""
    kept = UNIT_GAP.sub(NO_BREAK, text)
    lines = textwrap.wrap(kept, max(width, 20), break_long_words=False, break_on_hyphens=False)
    return [line.replace(NO_BREAK, " ") for line in lines] or [""]


def print_text(text: str, console: Console) -> None:
    """Print a line; what does not fit goes on below, two blanks further in than it begins."""
    indent = " " * (len(text) - len(text.lstrip(" ")))
    room = console.width - len(indent) - INDENT
    for k, piece in enumerate(wrapped(neutral(text.strip()), room)):
        console.print(styled(indent + " " * (INDENT if k else 0) + piece), soft_wrap=True)


def print_rows(header: Sequence[str], rows: Sequence[Sequence[Cell]], console: Console) -> None:
    """Print rows below a header; the last column takes what is left and is wrapped within it."""
    cells = [[cell if isinstance(cell, tuple) else (cell, "") for cell in row] for row in rows]
    wide = [max(len(neutral(text)) for text in (name, *(row[k][0] for row in cells)))
            for k, name in enumerate(header[:-1])]
    begin = sum(wide) + GAP * len(wide)
    for row in ([(name, "dim") for name in header], *cells):
        first = [part for (text, style), width in zip(row, wide)
                 for part in ((text, style), " " * (width - len(neutral(text)) + GAP))]
        text, style = row[-1]
        for piece in wrapped(neutral(text), max(console.width - begin, NARROWEST)):
            line = styled(*first, (piece, style))
            line.rstrip()
            console.print(line, soft_wrap=True)
            first = [" " * begin]
