"""Where libraries are kept between runs: arrays in files of the user's cache directory.

A file is written beside its place and renamed, so there are only whole ones; one that cannot be
read counts as absent.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

import numpy as np

from ema_record.sources import source_hash

FOLDER = "ema_phm"
NUMERICAL = ("numpy", "scipy", "numba")
"""Packages whose version may change what is computed."""
LARGEST = 500_000_000
"""Largest file that is read (bytes)."""


def cache_directory() -> Path:
    """Return ``$XDG_CACHE_HOME/ema_phm``, by default ``~/.cache/ema_phm``."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if base else Path.home() / ".cache") / FOLDER


def key_of(*parts: str, module: str) -> str:
    """Return a hash of `parts` and of all that the results of a module depend on.

    That is the sources that it imports, one through another, and the versions of the numerical
    packages.
    """
    digest = hashlib.sha256(source_hash(module).encode())
    for name in NUMERICAL:
        digest.update(f"\0{name} {metadata.version(name)}".encode())
    for part in parts:
        digest.update(b"\0" + part.encode())
    return digest.hexdigest()[:32]


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
