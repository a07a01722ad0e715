"""The kit: everything that the software knows of one type of actuator, in one folder.

``actuator.yaml`` (parameters, tolerances, conditions, drive, acquisition), ``profiles/`` (the
tests, made for its stroke and speed), ``cascade.json`` (trained), ``library/`` (for identify),
``validation.json`` and ``report.html`` (what it can detect). The shipped one, `config/`, is that
of the default actuator. A process works with one kit: what `$EMA_KIT` names, which processes that
it starts inherit; `--kit` of a command and `kit` of a node set it.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import shlex
import threading
import time
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import ParamSpec, TypeVar

from ema_record.errors import UsageError

Given = ParamSpec("Given")
Made = TypeVar("Made")

ENVIRONMENT = "EMA_KIT"
SHIPPED = "config"
ACTUATOR, PROFILES, CASCADE = "actuator.yaml", "profiles", "cascade.json"
LIBRARY, VALIDATION, REPORT = "library", "validation.json", "report.html"

PACKAGE = "ema_phm"


class _Block:
    """One use of a kit that has not ended, and what was used before it."""

    def __init__(self, thread: int, kit: str | None) -> None:
        self.thread, self.kit = thread, kit
        self.before: str | None = None


_LOCK, _BLOCKS = threading.Lock(), list[_Block]()


def share_path(relative: str) -> Path:
    """Return the path of a shipped file or folder.

    A checkout keeps them beside the packages; ``pip install`` and ``colcon build``
    put them into ``share/ema_phm`` of the prefix.
    """
    here = Path(__file__).resolve()
    for parent in here.parents:
        for candidate in (parent / relative, parent / "share" / PACKAGE / relative):
            if candidate.exists() and (candidate.parent != parent or parent == here.parents[1]):
                return candidate
    raise FileNotFoundError(f"{relative}: not found beside {here.parent} nor in a share folder")


@cache
def shipped_kit() -> Path:
    """Return the folder of the default actuator's kit."""
    return share_path(SHIPPED)


def kit_folder() -> Path:
    """Return the folder of the present kit.

    Raises
    ------
    UsageError
        What `$EMA_KIT` names is no kit.
    """
    named = os.environ.get(ENVIRONMENT, "")
    return check_kit(Path(named)) if named else shipped_kit()


def check_kit(folder: Path) -> Path:
    """Return `folder`; UsageError where it holds no `actuator.yaml`."""
    if not (folder / ACTUATOR).is_file():
        what = ("it is a file, give the folder that holds it" if folder.is_file() else
                f"it holds no {ACTUATOR}" if folder.is_dir() else "no such folder")
        raise UsageError(f"kit {folder}: {what}: 'ema new-actuator' begins one, "
                         "'ema commission' completes it")
    return folder


def use_kit(folder: str | Path | None) -> None:
    """Make `folder` the kit of this process and of those that it starts; None: no change."""
    if folder is not None and str(folder):
        os.environ[ENVIRONMENT] = str(check_kit(Path(folder)).resolve())


@contextlib.contextmanager
def using_kit(folder: str | Path | None) -> Iterator[None]:
    """Use a kit inside a ``with`` block; None: the shipped one.

    A process has one kit at a time: UsageError where another thread works with another one.
    """
    kit = None if folder is None else str(check_kit(Path(folder)).resolve())
    block = _Block(threading.get_ident(), kit)
    with _LOCK:
        if any(b.thread != block.thread and b.kit != kit for b in _BLOCKS):
            raise UsageError("another thread works with another kit: a process has one at a time, "
                             "give each kit a process of its own")
        block.before = os.environ.get(ENVIRONMENT)
        _BLOCKS.append(block)
        _set(kit)
    try:
        yield
    finally:
        with _LOCK:
            at = _BLOCKS.index(block)
            if at + 1 < len(_BLOCKS):  # of another thread: it ends with what was before both
                _BLOCKS[at + 1].before = block.before
            else:
                _set(block.before)
            del _BLOCKS[at]


def _set(kit: str | None) -> None:
    os.environ.pop(ENVIRONMENT, None)
    if kit is not None:
        os.environ[ENVIRONMENT] = kit


def with_present_kit(function: Callable[Given, Made]) -> Callable[Given, Made]:
    """Return a function for workers, which live longer than the kit they were started with."""
    return partial(_with_kit, os.environ.get(ENVIRONMENT) or None, os.getpid(), function)


def _with_kit(kit: str | None, parent: int, function: Callable[Given, Made], *given: Given.args,
              **named: Given.kwargs) -> Made:
    maker = multiprocessing.parent_process()
    if maker is not None and maker.pid == parent:  # a worker of that process's own
        _end_with(parent)
    with using_kit(kit):
        return function(*given, **named)


@cache
def _end_with(parent: int) -> None:
    """End this worker within a second of its parent, however that ends (loky: after 300 s)."""
    def wait() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def kit_path(name: str) -> Path:
    """Return where the present kit has, or would have, that file or folder."""
    return kit_folder() / name


def kit_file(name: str) -> tuple[Path, int]:
    """Return the path of a file of the present kit and when it changed (ns): a cache's key."""
    path = kit_path(name)
    return path, path.stat().st_mtime_ns


def kit_name() -> str:
    """Return the present kit as users name it."""
    return "the default kit" if is_default_kit() else f"kit {kit_folder()}"


def kit_option() -> str:
    """Return the option by which a command uses the present kit too; empty for the default one."""
    return "" if is_default_kit() else f" --kit {shlex.quote(os.path.relpath(kit_folder()))}"


def is_default_kit() -> bool:
    """Return whether the present kit is that of the default actuator."""
    return kit_folder().resolve() == shipped_kit().resolve()
