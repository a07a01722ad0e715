"""The `mcap` library's writer with a compression level, which it does not offer itself."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO

import mcap.writer
import zstandard

DEFAULT_LEVEL = 3
"""zstd level of the library; 0.5 us a sample."""
HIGHEST_LEVEL = 19

_LOCK = threading.Lock()


class _Zstandard:
    """Stands in for the module `zstandard` while one chunk is compressed."""

    def __init__(self, level: int) -> None:
        self.level = level

    def compress(self, data: bytes) -> bytes:
        return zstandard.compress(data, self.level)


@contextmanager
def _compressing(level: int) -> Iterator[None]:
    with _LOCK:
        original = mcap.writer.zstandard
        mcap.writer.zstandard = _Zstandard(level)  # type: ignore[assignment]
        try:
            yield
        finally:
            mcap.writer.zstandard = original


class LevelWriter(mcap.writer.Writer):
    """Writer of zstd chunks of a chosen level.

    The library compresses at its default level where it closes a chunk; that private method
    is extended here. With a version that has no such method any more the file stays valid and
    its chunks are of the default level.

    Parameters
    ----------
    stream : binary file
        Where the bytes go.
    chunk_size : int
        Size of a chunk before compression (bytes).
    level : int
        1 to 19.

    """

    def __init__(self, stream: IO[bytes], *, chunk_size: int, level: int = DEFAULT_LEVEL) -> None:
        """Make a writer; nothing is written before `start`."""
        super().__init__(stream, chunk_size=chunk_size, enable_data_crcs=True)
        self._level = level

    def _Writer__finalize_chunk(self) -> None:
        close_chunk = super()._Writer__finalize_chunk  # type: ignore[misc]
        if self._level == DEFAULT_LEVEL:
            close_chunk()
            return
        with _compressing(self._level):
            close_chunk()
