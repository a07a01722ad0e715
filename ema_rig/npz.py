"""NPZ archives as columns; arrays of objects, which would need pickle, are refused."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ema_record.errors import InvalidRecordError
from ema_rig.table import MAX_FILE_BYTES, Table, base_name, check_shape, real_array


def read_npz(path: Path, needed: Sequence[str | int] | None) -> Table:
    """Return the arrays of an NPZ file that are needed, those named by number included.

    Raises
    ------
    InvalidRecordError
        Damaged, too large, or an array that is not of numbers.

    """
    columns: dict[str, np.ndarray] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            names = [entry.filename.removesuffix(".npy") for entry in archive.infolist()]
            if needed is None:
                needed = names
            by_name = {base_name(str(name)) for name in needed if isinstance(name, str)}
            by_number = {names[n] for n in needed if isinstance(n, int) and n < len(names)}
            wanted = (by_name | by_number) & set(names)
            total = 0
            for entry in archive.infolist():
                if entry.filename.removesuffix(".npy") in wanted:
                    total += entry.file_size
            if total > MAX_FILE_BYTES:
                raise InvalidRecordError(f"{path}: {total} bytes once unpacked, at most "
                                         f"{MAX_FILE_BYTES}: import a part of it")
        with np.load(path, allow_pickle=False) as loaded:
            for name in names:
                columns[name] = _array(loaded[name], f"{path}: {name}") if name in wanted else \
                    np.empty((0, 0))
    except (zipfile.BadZipFile, ValueError, OSError, EOFError, KeyError, zlib.error,
            NotImplementedError,  # zipfile: a compression that it does not know
            RuntimeError,  # zipfile: an encrypted member
            SyntaxError, MemoryError,  # numpy: a damaged header
            ) as error:
        text = " ".join(str(error).split())[:80]
        raise InvalidRecordError(
            f"{path}: no NPZ file, damaged, or with objects that would need pickle ({text}): "
            "save arrays of numbers with numpy.savez") from None
    return Table(columns=columns, source=str(path))


def _array(value: np.ndarray, where: str) -> np.ndarray:
    numbers = real_array(value, where)
    if numbers.ndim:
        check_shape(max(numbers.shape), min(numbers.shape) if numbers.ndim == 2 else 1, where)
    return np.atleast_1d(numbers)
