"""Seeded standard normal numbers, drawn once for all runs that share a seed.

Candidates are compared on equal noise, so the same few seeds come again thousands of times.
"""

from __future__ import annotations

import copy
import math
from functools import lru_cache
from threading import Lock

import numpy as np

KEPT = 200_000
"""Numbers of a stream that are kept: the default test takes 190 000 for its currents."""
STREAMS = 64
"""Streams that are kept, the last ones used: at most 100 MB."""


class Normals:
    """Numbers of one stream in order: the same in blocks of any size."""

    def __init__(self, seed: int, stream: int) -> None:
        """Start at the begin of `stream`, a child of the `seed`'s sequence."""
        self._stream = _stream(seed, stream)
        self._place = 0
        self._own: np.random.Generator | None = None

    def take(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the next numbers; not to be written to."""
        if self._own is not None:
            return self._own.standard_normal(shape)
        start, end = self._place, self._place + math.prod(shape)
        self._place = end
        numbers = self._stream.first(min(end, KEPT))[start:]
        if end > KEPT:
            self._own = self._stream.after_kept()
            numbers = np.concatenate([numbers, self._own.standard_normal(end - KEPT)])
        return numbers.reshape(shape)


class _Stream:
    """The first `KEPT` numbers of a stream, drawn as they are asked for."""

    def __init__(self, sequence: np.random.SeedSequence) -> None:
        self._generator = np.random.Generator(np.random.PCG64(sequence))
        self._numbers = np.empty(KEPT)
        self._drawn = 0
        self._lock = Lock()

    def first(self, n: int) -> np.ndarray:
        """Return the first `n` numbers, shape (n,)."""
        with self._lock:
            if n > self._drawn:
                self._generator.standard_normal(out=self._numbers[self._drawn:n])
                self._drawn = n
        return self._numbers[:n]

    def after_kept(self) -> np.random.Generator:
        """Return a generator of what follows the kept numbers, all of which are drawn."""
        return copy.deepcopy(self._generator)


@lru_cache(maxsize=STREAMS)
def _stream(seed: int, stream: int) -> _Stream:
    return _Stream(np.random.SeedSequence(seed, spawn_key=(stream,)))
