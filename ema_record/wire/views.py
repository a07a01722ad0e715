"""The decimated views of the samples: `/ema/joint_states` and `/ema/phase_currents`.

A view is the mean over `factor` samples, so that it aliases no more than a sample does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_record.actuator import load_actuator
from ema_record.channels import (
    MOTOR_SPEED,
    N_CHANNELS,
    PHASE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
)
from ema_record.wire.sensors import encode_currents, encode_joint_states
from ema_record.wire.types import NANOSECONDS


@dataclass(frozen=True, slots=True, kw_only=True)
class Views:
    """Decimated samples.

    Attributes
    ----------
    time : ndarray, shape (n,). Since the acceptance of the command (s).
    position : ndarray, shape (n, 2). Motor (electrical, which is mechanical for one pole pair) and
        surface (rad).
    velocity : ndarray, shape (n, 2). Motor and surface (rad/s); that of the surface is the
        difference of its means.
    phase_current : ndarray, shape (n, 3). Phases a, b, c (A).
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    phase_current: np.ndarray

    def stamps(self, start_time: int) -> np.ndarray:
        """Return the times in ns since the epoch, the test having begun at `start_time`."""
        return start_time + np.rint(self.time * NANOSECONDS).astype(np.int64)

    def joint_states(self, start_time: int) -> list[bytes]:
        """Return the messages of `/ema/joint_states` as CDR."""
        return encode_joint_states(self.stamps(start_time), self.position, self.velocity)

    def phase_currents(self, start_time: int) -> list[bytes]:
        """Return the messages of `/ema/phase_currents` as CDR."""
        return encode_currents(self.stamps(start_time), self.phase_current)


class ViewDecimator:
    """Makes views of samples that come block by block.

    Parameters
    ----------
    rate : samples a second (1/s).
    view_rate : views a second (1/s), default that of the nominal acquisition.
    """

    def __init__(self, rate: float, view_rate: float | None = None) -> None:
        if view_rate is None:
            view_rate = load_actuator().acquisition.view_rate
        self.factor = max(1, round(rate / view_rate))
        self._rest = np.empty((0, N_CHANNELS))
        self._last: tuple[float, float] | None = None

    def push(self, block: np.ndarray) -> Views:
        """Return the views that the block, shape (k, 10), completes."""
        samples = np.concatenate([self._rest, block]) if len(self._rest) else block
        n = len(samples) // self.factor
        self._rest = samples[n * self.factor:].copy()
        groups = samples[: n * self.factor].reshape(n, self.factor, N_CHANNELS)
        mean = groups.mean(axis=1)
        motor = np.unwrap(groups[:, :, ROTOR_ANGLE], axis=1).mean(axis=1)
        surface = mean[:, SURFACE_POSITION]
        return Views(
            time=mean[:, TIME],
            position=np.column_stack([motor, surface]),
            velocity=np.column_stack(
                [mean[:, MOTOR_SPEED], self._surface_velocity(mean[:, TIME], surface)]
            ),
            phase_current=mean[:, PHASE_CURRENTS],
        )

    def _surface_velocity(self, time: np.ndarray, position: np.ndarray) -> np.ndarray:
        """Return the difference quotient to the view before, 0 for the first of all (rad/s)."""
        if len(time) == 0:
            return np.empty(0)
        before = self._last or (time[0] - 1.0, position[0])
        self._last = float(time[-1]), float(position[-1])
        return np.diff(position, prepend=before[1]) / np.diff(time, prepend=before[0])
