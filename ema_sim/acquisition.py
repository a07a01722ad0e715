"""What the acquisition makes of the kernel's samples: sensor noise and converters.

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

from ema_record.actuator import NOISE_RATE, Acquisition, Actuator, Converters
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
TURN = 2.0 * math.pi
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

    `level` scales all deviations of `actuator.noise`.
    """

    def __init__(self, actuator: Actuator, seed: int, level: float, rate: float) -> None:
        """Start the generators."""
        self._inside, self._record = Normals(seed, 0), Normals(seed, 1)
        period_scale = np.sqrt(1.0 / (actuator.control.period * NOISE_RATE))
        self._inside_sigma = level * period_scale * np.array(
            [actuator.noise.speed, actuator.noise.position]
        )
        c = actuator.converters
        self._speed_offset = (actuator.acquisition.converters * c.speed_offset
                              * c.speed_range / 2.0**c.speed_bits)
        self._current_sigma = level * actuator.sample_noise(rate).current

    def inside(self, n: int) -> np.ndarray:
        """Return errors of speed (rad/s) and position (rad), shape (n, 2), one a period."""
        found = self._inside.take((n, 2)).copy()
        found[:, 0] = self._inside_sigma[0] * found[:, 0] + self._speed_offset
        found[:, 1] *= self._inside_sigma[1]
        return found

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


def convert(
    c: Converters, acquisition: Acquisition, samples: np.ndarray, current_noise: np.ndarray
) -> np.ndarray:
    """Make what is recorded of the kernel's `samples`, in place, and return them.

    Noise is added, every channel goes through its converter if there are any, and what is not
    recorded is not a number.

    Parameters
    ----------
    c, acquisition : the converters; whether they are there, and which channels are recorded.
    samples : ndarray, shape (n, 10), from the kernel; rotor angle not wrapped.
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
    _convert(samples, current_noise, spans / 2.0**bits, 0.5 * spans,
             acquisition.converters != 0)
    for channels, recorded in (
        (PHASE_CURRENTS.stop - 1, acquisition.phase_current_c),
        (REFERENCE_CURRENTS, acquisition.reference_currents),
        (ROTOR_ANGLE, acquisition.rotor_angle),
        (SURFACE_POSITION, acquisition.surface_position),
    ):
        if not recorded:
            samples[:, channels] = np.nan
    return samples


@njit(cache=True, error_model="numpy", nogil=True)
def _convert(
    samples: np.ndarray, noise: np.ndarray, step: np.ndarray, half: np.ndarray, rounded: bool
) -> None:
    """Add `noise` to the phase currents; round to steps within ± `half` a column if `rounded`.

    The rotor angle is wrapped and, if rounded, rounded down; time stays as it is.
    """
    per = 1.0 / step
    for i in range(samples.shape[0]):
        for k in range(3):
            samples[i, 2 + k] += noise[i, k]
        angle = samples[i, ROTOR_ANGLE]
        angle -= TURN * math.floor(angle * (1.0 / TURN))
        angle = 0.0 if angle >= TURN else angle
        if rounded:
            for k in range(1, N_CHANNELS):
                value = np.rint(samples[i, k] * per[k]) * step[k]
                samples[i, k] = min(max(value, -half[k]), half[k]) + 0.0
            angle = math.floor(angle * per[ROTOR_ANGLE]) * step[ROTOR_ANGLE]
        samples[i, ROTOR_ANGLE] = angle
