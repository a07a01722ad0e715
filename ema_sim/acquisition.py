"""What the acquisition makes of the kernel's means: sensor noise and converters.

The noise is made of seeded standard normal numbers, drawn once for all runs that share a seed:
candidates are compared on equal noise, so the same few seeds come again thousands of times.
"""

from __future__ import annotations

import copy
import math
from functools import lru_cache
from threading import Lock

import numpy as np
from numba import njit

from ema_record.actuator import NOISE_RATE, Actuator, Converters
from ema_record.channels import (
    MOTOR_SPEED,
    N_CHANNELS,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
)
from ema_sim.effects.registry import Effects

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


class SensorNoise:
    """Seeded white noise, drawn in order: the same seed gives the same bytes in any blocks.

    `level` scales all deviations of `actuator.noise` (rms a sample at `NOISE_RATE`).
    """

    def __init__(self, actuator: Actuator, seed: int, level: float, rate: float) -> None:
        """Start the generators."""
        self._inside, self._record = Normals(seed, 0), Normals(seed, 1)
        period_scale = np.sqrt(1.0 / (actuator.control.period * NOISE_RATE))
        self._inside_sigma = level * period_scale * np.array(
            [actuator.noise.speed, actuator.noise.position]
        )
        self._current_sigma = level * actuator.noise.current * np.sqrt(rate / NOISE_RATE)

    def inside(self, n: int) -> np.ndarray:
        """Return noise of speed (rad/s) and position (rad), shape (n, 2), one a period."""
        return self._inside.take((n, 2)) * self._inside_sigma

    def currents(self, n: int) -> np.ndarray:
        """Return noise of the phase currents, shape (n, 3) (A), a sample each."""
        return self._record.take((n, 3)) * self._current_sigma


def effective_converters(nominal: Converters, effects: Effects) -> Converters:
    """Return the converters with the bits that `quantisation` took away."""
    q = effects.quantisation
    return nominal._replace(
        position_range=nominal.position_range * 2.0**q.position_bits_lost,
        speed_range=nominal.speed_range * 2.0**q.speed_bits_lost,
    )


def convert(c: Converters, means: np.ndarray, current_noise: np.ndarray) -> np.ndarray:
    """Return the samples as recorded: noise added, every channel through its converter.

    Parameters
    ----------
    c : the converters.
    means : ndarray, shape (n, 10), from the kernel; rotor angle not wrapped.
    current_noise : ndarray, shape (n, 3) (A).
    """
    spans, bits = np.full(N_CHANNELS, math.inf), np.zeros(N_CHANNELS)
    for columns, span, depth in (
        (MOTOR_SPEED, c.speed_range, c.speed_bits),
        (PHASE_CURRENTS, c.current_range, c.current_bits),
        (REFERENCE_CURRENTS, c.current_range, c.current_bits),
        (ROTOR_ANGLE, c.angle_range, c.angle_bits),
        (SURFACE_POSITION, c.position_range, c.position_bits),
    ):
        spans[columns], bits[columns] = span, depth
    return _converted(means, current_noise, PHASE_CURRENTS.start, spans / 2.0**bits, 0.5 * spans)


@njit(cache=True, error_model="numpy", nogil=True)
def _converted(
    means: np.ndarray, noise: np.ndarray, first: int, step: np.ndarray, half: np.ndarray
) -> np.ndarray:
    """Return `means` with `noise` in columns `first` on, in steps and within ± `half` a column.

    The rotor angle is wrapped and rounded down; a column with an infinite step is left alone.
    """
    samples = means + 0.0
    rows = means.shape[0]
    for k in range(noise.shape[1]):
        for i in range(rows):
            samples[i, first + k] += noise[i, k]
    for k in range(means.shape[1]):
        one, most = step[k], half[k]
        if k == ROTOR_ANGLE:
            for i in range(rows):
                samples[i, k] = math.floor(samples[i, k] % (2.0 * math.pi) / one) * one + 0.0
        elif one < math.inf:
            for i in range(rows):
                value = np.rint(samples[i, k] / one) * one
                samples[i, k] = min(max(value, -most), most) + 0.0
    return samples
