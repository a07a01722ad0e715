"""What a drive with field-oriented control measures, as channels: i_d, i_q, angle, or i_q alone.

Amplitudes of the phases (A), θ the electrical angle of the kit, φ_k = 0, 120°, 240°::

    i_k = i_q sin(θ - φ_k) + i_d cos(θ - φ_k)
    i_q = 2/3 Σ i_k sin(θ - φ_k),  i_d = 2/3 Σ i_k cos(θ - φ_k)

The back-EMF of phase a is k ω sin θ, so that i_q makes the torque, and the sum of the three is
zero (R. H. Park, Trans. AIEE 48, 1929; E. Clarke, Circuit Analysis of A-C Power Systems, 1943).
"""

from __future__ import annotations

import math

import numpy as np

from ema_record.actuator import Actuator
from ema_record.channels import (
    MOTOR_SPEED,
    N_CHANNELS,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
)
from ema_record.errors import UsageError

PHASES = 2.0 * math.pi / 3.0 * np.arange(3)
"""φ_k of the phases a, b, c (rad)."""


def phase_currents(d: np.ndarray, q: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the phase currents, shape (n, 3) (A), of i_d, i_q (A) and angle (rad), shape (n,)."""
    theta = angle[:, None] - PHASES
    found: np.ndarray = q[:, None] * np.sin(theta) + d[:, None] * np.cos(theta)
    return found


def rotor_currents(currents: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return i_d and i_q, shape (n,) (A), of phase currents, shape (n, 3) (A), at angles (rad)."""
    theta = angle[:, None] - PHASES
    return (2.0 / 3.0 * (currents * np.cos(theta)).sum(axis=1),
            2.0 / 3.0 * (currents * np.sin(theta)).sum(axis=1))


class RotorFrame:
    """Makes samples of what a drive measures in the rotor's frame, block after block.

    Parameters
    ----------
    actuator : the kit's; its pole pairs turn the speed into an angle where none is measured.
    """

    def __init__(self, actuator: Actuator) -> None:
        """Begin a run: the angle, if it is not measured, is 0 at its first sample."""
        self._pairs = actuator.motor.pole_pairs
        self._last: tuple[float, float, float] | None = None

    def samples(
        self, time: np.ndarray, speed: np.ndarray, q: np.ndarray, *,
        d: np.ndarray | None = None, angle: np.ndarray | None = None,
        reference_q: np.ndarray | None = None, reference_d: np.ndarray | None = None,
        position: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return samples, shape (n, 10), NaN where a channel is not measured.

        Parameters
        ----------
        time, speed : since the acceptance of the command (s); of the motor (rad/s), shape (n,).
        q, d : i_q and i_d (A); without i_d it is zero, which the control holds it to.
        angle : electrical (rad); without one it is the integral of the speed from 0 on, so that
            which phase is which is not known, and it is no channel of the samples.
        reference_q, reference_d : what the control asks for (A); along d it is zero unless given.
        position : of the surface (rad).

        Raises
        ------
        UsageError
            They are not of one length.
        """
        given = {"speed": speed, "q": q, "d": d, "angle": angle, "reference_q": reference_q,
                 "reference_d": reference_d, "position": position}
        for name, values in given.items():
            if values is not None and values.shape != time.shape:
                raise UsageError(f"{name} has shape {values.shape}, time {time.shape}: give a "
                                 "value for each sample")
        out = np.full((len(time), N_CHANNELS), np.nan)
        out[:, TIME], out[:, MOTOR_SPEED] = time, speed
        theta = self._integrated(time, speed) if angle is None else angle
        zero = np.zeros_like(q)
        out[:, PHASE_CURRENTS] = phase_currents(zero if d is None else d, q, theta)
        if reference_q is not None:
            out[:, REFERENCE_CURRENTS] = phase_currents(
                zero if reference_d is None else reference_d, reference_q, theta)
        if angle is not None:
            out[:, ROTOR_ANGLE] = np.mod(angle, 2.0 * math.pi)
        if position is not None:
            out[:, SURFACE_POSITION] = position
        return out

    def _integrated(self, time: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Return the angle (rad) by the speed, on from the last sample of the block before."""
        if not len(time):
            return np.empty(0)
        before, rate, start = self._last or (float(time[0]), float(speed[0]), 0.0)
        t, w = np.append(before, time), self._pairs * np.append(rate, speed)
        angle: np.ndarray = start + np.cumsum(0.5 * (w[1:] + w[:-1]) * np.diff(t))
        self._last = float(time[-1]), float(speed[-1]), float(angle[-1])
        return angle
