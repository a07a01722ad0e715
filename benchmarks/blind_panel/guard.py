"""Keep the answers from the process that identifies: it cannot open or import them."""

from __future__ import annotations

import os
import sys
from pathlib import Path

TRUTH = "benchmarks.blind_panel.truth"
_LOCKED: list[str] = []


def lock(sealed: Path) -> None:
    """Refuse, for the rest of this process, to open anything below `sealed`, or the truth.

    An audit hook of the interpreter: it cannot be taken out again, and sees `open` of Python
    and of numpy, listings, copies and imports.

    Raises
    ------
    ImportError
        The process has imported the truth already: a lock would keep nothing from it.
    """
    if any(name.startswith(TRUTH) for name in sys.modules):
        raise ImportError("this process has imported the truth: it is not to identify")
    place = os.path.realpath(sealed)
    if not _LOCKED:
        sys.addaudithook(_watch)
    if place not in _LOCKED:
        _LOCKED.append(place)


def _watch(event: str, arguments: tuple[object, ...]) -> None:
    if event in ("open", "os.listdir", "os.scandir", "os.rename", "os.link", "os.symlink",
                 "shutil.copyfile", "shutil.copytree"):
        for argument in arguments[:2]:
            if isinstance(argument, str | bytes | os.PathLike) and _inside(argument):
                raise PermissionError(f"{event}: the answers are sealed while identifying")
    elif event == "import" and str(arguments[0]).startswith(TRUTH):
        raise ImportError("the truth is closed to the process that identifies")


def _inside(path: str | bytes | os.PathLike[str]) -> bool:
    place = os.path.realpath(os.fsdecode(path))
    return any(place == locked or place.startswith(locked + os.sep) for locked in _LOCKED)
