"""What code a result depends on: the sources of modules and of all that they import of our own.

A cache or a store keyed by it is never stale, and nobody keeps a list: imports are read off the
sources, those inside of functions too. (A module imported by a name that is put together while
the program runs is not seen; there is none.)
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
"""Folder that holds our packages, in a checkout and where they are installed."""
OURS = "ema_"
"""How the names of our packages begin."""


@cache
def source_hash(*modules: str, root: Path = ROOT) -> str:
    """Return a hash of the sources that `modules` depend on, read once a process.

    Parameters
    ----------
    *modules : dotted names, e.g. ``ema_sim.simulate``.
    root : folder that holds the packages.

    Raises
    ------
    ModuleNotFoundError
        There is no such module of ours.
    """
    digest = hashlib.sha256()
    for name, path in sorted(sources_of(*modules, root=root).items()):
        digest.update(f"{name}\0".encode() + path.read_bytes() + b"\0")
    return digest.hexdigest()


def sources_of(*modules: str, root: Path = ROOT) -> dict[str, Path]:
    """Return the modules below `root` that `modules` depend on, themselves too, by dotted name.

    A module depends on the packages that it lies in and on what it imports.
    """
    found: dict[str, Path] = {}
    waiting = list(modules)
    for name in modules:
        if _file_of(name, root) is None:
            raise ModuleNotFoundError(f"{name}: no such module below {root}")
    while waiting:
        name = waiting.pop()
        path = _file_of(name, root)
        if name in found or path is None:
            continue
        found[name] = path
        waiting.append(name.rpartition(".")[0])
        waiting += _imports(path.read_bytes())
    return found


def _file_of(name: str, root: Path) -> Path | None:
    """Return the source of a module of ours; None for what is none (a function, a library)."""
    if not name.startswith(OURS):
        return None
    place = root.joinpath(*name.split("."))
    for path in (place / "__init__.py", place.with_suffix(".py")):
        if path.is_file():
            return path
    return None


@cache
def _imports(text: bytes) -> tuple[str, ...]:
    """Return the names that a source imports, each of which may be a module."""
    found: list[str] = []
    for node in _statements(ast.parse(text)):
        if isinstance(node, ast.Import):
            found += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            found += (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
    return tuple(found)


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """Return all statements within one, those of its parts too; no expressions."""
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        inner = getattr(node, part, None)
        for statement in inner if isinstance(inner, list) else ():
            yield statement
            yield from _statements(statement)
