"""Where libraries are kept between runs: arrays in files of the user's cache directory.

A file is written beside its place and renamed, so there are only whole ones; one that cannot be
read counts as absent.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import numpy as np

FOLDER = "ema_phm"
OWN = "ema_"
"""How the names of our own packages begin."""
NUMERICAL = ("numpy", "scipy", "numba")
"""Packages whose version may change what is computed."""
LARGEST = 500_000_000
"""Largest file that is read (bytes)."""


def cache_directory() -> Path:
    """Return ``$XDG_CACHE_HOME/ema_phm``, by default ``~/.cache/ema_phm``."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if base else Path.home() / ".cache") / FOLDER


def key_of(*parts: str, module: str) -> str:
    """Return a hash of `parts` and of all that results of a module depend on (`code_hash`)."""
    digest = hashlib.sha256(code_hash(module))
    for part in parts:
        digest.update(b"\0" + part.encode())
    return digest.hexdigest()[:32]


@cache
def code_hash(module: str) -> bytes:
    """Return a hash of a module, of all our modules that it imports and of numerical packages.

    Imports are followed one through another; files are read once, as the code that runs is.
    """
    digest = hashlib.sha256()
    for name, path in sorted(sources_of(module).items()):
        digest.update(name.encode() + b"\0" + path.read_bytes())
    for name in NUMERICAL:
        digest.update(f"\0{name} {metadata.version(name)}".encode())
    return digest.digest()


def sources_of(module: str) -> dict[str, Path]:
    """Return the files of a module and of all our modules that it imports, by name."""
    found: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if not name.startswith(OWN) or name in found:
            continue
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            continue  # a name within a module, or a folder without code
        path = Path(spec.origin)
        found[name] = path
        if "." in name:
            waiting.append(name.rpartition(".")[0])
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.Import):
                waiting += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                waiting.append(node.module)
                waiting += _modules_in(node)
    return found


def _modules_in(node: ast.ImportFrom) -> list[str]:
    """Return the modules among what is imported from a package of ours."""
    package = node.module or ""
    if not package.startswith(OWN) or (spec := find_spec(package)) is None:
        return []
    places = [Path(place) for place in spec.submodule_search_locations or ()]
    return [f"{package}.{alias.name}" for alias in node.names
            if any((place / f"{alias.name}.py").exists() or (place / alias.name).is_dir()
                   for place in places)]


def load(name: str) -> dict[str, np.ndarray] | None:
    """Return the arrays kept under `name`, None if there are none."""
    path = cache_directory() / f"{name}.npz"
    try:
        if path.stat().st_size > LARGEST:
            return None
        with np.load(path, allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def save(name: str, arrays: Mapping[str, np.ndarray]) -> None:
    """Keep arrays under `name`; where nothing can be written, nothing is kept."""
    folder = cache_directory()
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=folder, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez(file, **arrays)  # type: ignore[arg-type]
            Path(temporary).replace(folder / f"{name}.npz")
        finally:
            Path(temporary).unlink(missing_ok=True)
