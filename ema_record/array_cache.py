"""Arrays that were computed once: kept in files, under keys that name all that they depend on.

A file is written beside its place and renamed, so there are only whole ones; one that cannot be
read, or holds other arrays than were kept, counts as absent.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import zipfile
import zlib
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

import numpy as np

from ema_record.errors import OutputError
from ema_record.files import new_file
from ema_record.sources import source_hash

FOLDER = "ema_phm"
NUMERICAL = ("numpy", "scipy", "numba")
"""Packages whose version may change what is computed."""
LARGEST = 500_000_000
"""Largest file that is read, as it is and unpacked (bytes)."""
DAMAGED = (
    OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error,
    NotImplementedError,  # zipfile: a compression that it does not know
    RuntimeError,  # zipfile: an encrypted member
    SyntaxError, MemoryError,  # numpy: a damaged header
)
"""What reading an NPZ file raises where it holds no arrays."""
DIGEST = "sha256"
"""Name of the array with the hash of all others."""


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
        digest.update(b"\0" + part.encode(errors="surrogateescape"))  # of any path
    return digest.hexdigest()[:32]


def load(name: str, folder: Path | None = None) -> dict[str, np.ndarray] | None:
    """Return the arrays kept under `name`, None if there are none.

    Parameters
    ----------
    name : key, as `key_of` gives it.
    folder : where they are kept, default `cache_directory`.
    """
    try:
        found = read_arrays(_place(name, folder))
        kept = found.pop(DIGEST, np.empty(0))
        return found if np.array_equal(kept, _digest(found)) else None
    except DAMAGED:
        return None


def _digest(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the SHA-256 of arrays and their names, shape (32,)."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        array = arrays[name]
        found.update(f"{name} {array.dtype.str} {array.shape}\0".encode() + array.tobytes())
    return np.frombuffer(found.digest(), dtype=np.uint8)


def save(
    name: str, arrays: Mapping[str, np.ndarray], folder: Path | None = None, *,
    compressed: bool = False,
) -> None:
    """Keep arrays under `name`, see `load`; where nothing can be written, nothing is kept."""
    path = _place(name, folder)
    with contextlib.suppress(OSError, OutputError):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)  # a damaged one
        write_arrays(path, {**arrays, DIGEST: _digest(arrays)}, compressed=compressed)


def forget(prefix: str) -> None:
    """Remove the arrays kept in the cache under ``<prefix>_<number>``: parts of a whole."""
    for path in cache_directory().glob(f"{prefix}_*.npz"):
        if path.stem[len(prefix) + 1:].isdigit():
            with contextlib.suppress(OSError):
                path.unlink()


def _place(name: str, folder: Path | None) -> Path:
    return (cache_directory() if folder is None else folder) / f"{name}.npz"


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a file by name; one of `DAMAGED` if it holds none."""
    if not path.is_file():  # a pipe would wait for ever
        raise FileNotFoundError(path)
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size > LARGEST:
            raise ValueError(f"{path}: more than {LARGEST} bytes")
        with zipfile.ZipFile(file) as parts:
            if sum(part.file_size for part in parts.infolist()) > LARGEST:
                raise ValueError(f"{path}: more than {LARGEST} bytes unpacked")
        file.seek(0)
        with np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}


def write_arrays(
    path: Path, arrays: Mapping[str, np.ndarray], *, compressed: bool = False
) -> None:
    """Write arrays into a new file, whole or not at all; OutputError if there is one already."""
    with new_file(path) as temporary, temporary.open("wb") as file:
        (np.savez_compressed if compressed else np.savez)(
            file, **arrays)  # type: ignore[arg-type]


def rounded(values: np.ndarray, step: np.ndarray | float) -> np.ndarray:
    """Return values in float32, on multiples of the next lower power of two of `step`.

    Their last bits are zero, so that they are kept in few bytes.
    """
    grid = 2.0 ** np.floor(np.log2(step))
    return np.asarray(np.round(values / grid) * grid, dtype=np.float32)
