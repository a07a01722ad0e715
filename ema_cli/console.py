"""What all commands share: terminals, JSON output, progress bars, errors as one line.

Results go to standard output, everything else (progress, notes, errors) to standard error,
so that ``--json`` can be piped. rich is imported on first use.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

from ema_record.errors import InvalidRecordError

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

WRONG_USE = 2
LITTLE = 0.02
"""Part of the whole up to which a pace says nothing of the rest."""
SOON = 3.0
"""Time before which a pace says nothing of the rest (s)."""
BETWEEN_LINES = 10.0
"""Least time between two lines that tell how far something is, where there is no bar (s)."""
WHOLE = 100_000
"""Width (characters) of a console in which no line is wrapped."""
_STEERING = re.compile(
    "[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Control characters, marks that turn the direction of writing, bytes that are no text."""


class Speech(NamedTuple):
    """How much is said."""

    verbose: bool = False
    quiet: bool = False


_speech = Speech()


def speech() -> Speech:
    """Return how much is said now."""
    return _speech


@contextlib.contextmanager
def speaking(*, verbose: bool, quiet: bool) -> Iterator[None]:
    """Say more, or less, inside a ``with`` block."""
    global _speech  # noqa: PLW0603  (of the process, as the terminal is)
    before, _speech = _speech, Speech(verbose, quiet)
    try:
        yield
    finally:
        _speech = before


def stdout() -> Console:
    """Return the console of results: text is no markup, and lines are whole in a pipe."""
    from rich.console import Console

    narrow = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Console(markup=False, emoji=False, highlight=False, width=None if narrow else WHOLE)


def stderr() -> Console:
    """Return the console of progress."""
    from rich.console import Console

    return Console(stderr=True, markup=False, emoji=False, highlight=False)


def unicode_output() -> bool:
    """Return whether standard output takes more than ASCII."""
    return (getattr(sys.stdout, "encoding", None) or "").lower().replace("-", "") == "utf8"


def neutral(text: str) -> str:
    r"""Return text from outside on one line, with what steers a terminal as ``\u001b``."""
    return _STEERING.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def styled(*parts: str | tuple[str, str]) -> Text:
    """Return a line of texts from anywhere, each alone or with a style."""
    from rich.text import Text

    line = Text()
    for part in parts:
        text, style = (part, "") if isinstance(part, str) else part
        line.append(neutral(text), style)
    return line


def plain_table(**options: Any) -> Table:
    """Return a table without lines."""
    from rich.table import Table

    return Table(box=None, padding=(0, 2, 0, 0), **options)


def print_table(table: Table) -> None:
    """Print a table of results without blanks at the ends of its lines."""
    console = stdout()
    with console.capture() as printed:
        console.print(table)
    for line in printed.get().splitlines():
        print(line.rstrip())


def say(text: str) -> None:
    """Print one line of results."""
    print(neutral(text))


def note(text: str) -> None:
    """Print one line for the person at the terminal, to standard error, unless it is quiet."""
    if not _speech.quiet:
        _complain(text)


def _complain(text: str) -> None:
    print(neutral(text), file=sys.stderr, flush=True)


def print_json(value: object) -> None:
    """Print `value` as one line of JSON; numbers that are not finite become null."""
    text = json.dumps(_plain(value), allow_nan=False, ensure_ascii=not unicode_output())
    print(neutral(text), flush=True)  # inside strings JSON has the same escapes


def _plain(value: object) -> object:
    """Return `value` in types that JSON knows."""
    if isinstance(value, dict):
        return {str(name): _plain(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if hasattr(value, "tolist"):  # numpy
        return _plain(value.tolist())
    return str(value)


@contextlib.contextmanager
def _bar(description: str, total: float | None) -> Iterator[Callable[..., None]]:
    """Show a progress bar on standard error, if that is a terminal; yields its update."""
    if not sys.stderr.isatty() or _speech.quiet:
        yield lambda **_now: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    part = () if total is None else (TextColumn("{task.percentage:>3.0f} %"),)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), *part,
               TimeElapsedColumn(), TextColumn("{task.fields[left]}"))
    with Progress(*columns, console=stderr(), transient=True) as bar:
        task = bar.add_task(neutral(description), total=total, left="")

        def update(*, completed: float = 0.0, left: str | None = None, **now: Any) -> None:
            if left is None:
                left = "" if not total else time_left(
                    bar.tasks[0].elapsed or 0.0, completed / total)
            bar.update(task, completed=completed, left=left, **now)

        yield update


def time_left(elapsed: float, part: float) -> str:
    """Return in words how long the rest takes at the pace so far; empty where that says little.

    Parameters
    ----------
    elapsed : time so far (s).
    part : how much of the whole is done, 0 to 1.
    """
    if elapsed < SOON or not LITTLE < part < 1.0:
        return ""
    left = elapsed * (1.0 - part) / part
    for unit, seconds in (("h", 3600.0), ("min", 60.0)):
        if left >= 1.5 * seconds:
            return f"{left / seconds:.0f} {unit} left"
    return f"{left:.0f} s left"


@contextlib.contextmanager
def progress(description: str, total: float | None = None) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on standard error, if that is a terminal.

    Parameters
    ----------
    description : what takes the time.
    total : the value at which it is done; None shows that it is alive.

    Yields
    ------
    Takes how much is done by now, in the unit of `total`.
    """
    with _bar(description, total) as update:
        yield lambda done: update(completed=done)


@contextlib.contextmanager
def progress_of(description: str) -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar that also says what goes on, as `progress` does.

    Where standard error is no terminal a line is written instead, now and then.

    Yields
    ------
    Takes what goes on and how much of the whole is done, 0 to 1.
    """
    with _bar(description, 1.0) as update:
        pace = _Pace()

        def step(what: str, part: float) -> None:
            left = pace.left(part)
            update(description=neutral(what), completed=part, left=left)
            if not sys.stderr.isatty() and pace.due():
                note(", ".join(filter(None, (f"{what}: {100.0 * part:.0f} %", left))))

        yield step


class _Pace:
    """How fast something goes on; it begins anew where less is done than before.

    What is done within its first seconds was there already, of a work that is taken up again.
    """

    def __init__(self) -> None:
        self._begun = self._since = self._told = time.monotonic()
        self._first = self._last = 0.0

    def left(self, part: float) -> str:
        """Return how long the rest takes, `part` being done."""
        now = time.monotonic()
        if part < self._last:
            self._begun = self._since = now
            self._first = part
        if now - self._begun < SOON:
            self._since, self._first = now, part
        self._last = part
        return time_left(
            now - self._since, (part - self._first) / max(1.0 - self._first, 1e-9))

    def due(self) -> bool:
        """Return whether a line should tell how much is done: if none did for some time."""
        now = time.monotonic()
        if now - self._told < BETWEEN_LINES:
            return False
        self._told = now
        return True


@contextlib.contextmanager
def drawing() -> Iterator[None]:
    """Draw pictures, after what was printed has left this process."""
    sys.stdout.flush()
    with progress("plotting"):
        yield


def error_line(text: str) -> None:
    """Print an error as one line on standard error."""
    with contextlib.suppress(OSError, ValueError):
        _complain("ema: " + " ".join(text.split()))


def given_bags(paths: Iterable[Path]) -> list[Path]:
    """Return the bags among `paths` and in those that are directories of bags.

    Raises
    ------
    InvalidRecordError
        There is none.
    """
    from ema_record.bag.find import bags_of, is_sequence, named

    bags: list[Path] = []
    for path in map(named, paths):
        if not is_sequence(path):
            bags.append(path)
            continue
        inside, others = bags_of(path)
        if others:
            note(f"{path}: not bags, left out: {', '.join(p.name for p in others[:5])}"
                 + (f" and {len(others) - 5} more" if len(others) > 5 else ""))
        bags += inside
    if not bags:
        raise InvalidRecordError("no bag: give bags, or a directory that holds them")
    return bags


def check_new(folder: Path | None, *, bag: bool = False) -> None:
    """Raise OutputError unless this folder, or bag, can be made; called before the work begins."""
    from ema_record.bag.container import check_name, check_place

    if folder is None:
        return
    check_place(folder)
    if bag:
        check_name(folder)
    first = folder
    while not first.parent.exists():
        first = first.parent
    _try_to_write(first, folder)


def check_new_file(*files: Path | None) -> None:
    """Raise OutputError unless these files can be made; called before the work begins."""
    from ema_record.files import exists

    for file in files:
        if file is None:
            continue
        if file.exists() or file.is_symlink():
            raise exists(file)
        _try_to_write(file, file)


def _try_to_write(path: Path, output: Path) -> None:
    """Raise OutputError unless a new file beside `path`, of about its name, can be made."""
    from ema_record.files import cannot_write

    trial = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        trial.touch(exist_ok=False)
        trial.unlink()
    except OSError as error:
        raise cannot_write(output, error) from None
