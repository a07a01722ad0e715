"""The torque residual at each line: what modulates the torque constants, in parts of the torque.

With the torque current ``q = Σ k_k(θ) i_k / 2k`` and the motor speed ω, both as complex lines
against the rotor angle, the torque that no nominal winding explains is, relative to the mean
torque 2k q_0,

    m_h = (i J h ω W_h + T_h − 2k q_h) / (2k q_0)

where T_h is the torque of the shaft and the surface behind it. A short of x of the turns gives
|m_2| = 0.278 x and |m_4| = 0.132 x, the phase in their angle (DESIGN, section 4).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ema_prognostics.spectrum import rotor_lines
from ema_prognostics.turns import TURN, Turns
from ema_record.channels import MOTOR_SPEED
from ema_record.errors import IncompleteRecordError

HARMONICS = 6


class Plant(NamedTuple):
    """Nominal constants of the actuator that the features need; part of the model file."""

    back_emf_constant: float
    """k of a phase (V s/rad)."""
    flat_top: float
    """Width of the trapezoid's flat top (rad)."""
    torque_limit: float
    """N m."""
    motor_inertia: float
    """kg m²."""
    gear_ratio: float
    surface_inertia: float
    """kg m²."""
    surface_viscous_friction: float
    """N m s/rad."""
    shaft_stiffness: float
    """N m/rad."""
    shaft_damping: float
    """N m s/rad."""


class TorqueLines(NamedTuple):
    """Lines of one segment."""

    residual: np.ndarray
    """m_1..m_6, complex, shape (6,), relative to the mean torque."""
    mean_current: float
    """q_0 along the sense of rotation (A): the torque current that friction takes."""
    speed: float
    """Mean motor speed along the sense of rotation (rad/s)."""


def trapezoid(theta: np.ndarray, flat_top: float) -> np.ndarray:
    """Return the unit trapezoid: zero at 0 and π, flat top `flat_top` wide (rad) around π/2."""
    ramp = 0.5 * (np.pi - flat_top)
    x = np.mod(theta, TURN)
    half = np.mod(x, np.pi)
    value = np.clip(np.minimum(half, np.pi - half) / ramp, 0.0, 1.0)
    return np.where(x < np.pi, value, -value)


def torque_current(theta: np.ndarray, currents: np.ndarray, flat_top: float) -> np.ndarray:
    """Return q, shape (n,) (A), of phase currents, shape (n, 3) (A), at `theta` (rad)."""
    shape = np.stack([trapezoid(theta - k * TURN / 3.0, flat_top) for k in range(3)], axis=1)
    return 0.5 * np.sum(shape * currents, axis=1)


def torque_lines(turns: Turns, currents: np.ndarray, plant: Plant) -> TorqueLines:
    """Return the torque residual of a segment.

    Parameters
    ----------
    turns : whole turns of the rotor.
    currents : ndarray, shape (n, 3), corrected phase currents of the same samples (A).
    plant : nominal constants.
    """
    q = torque_current(turns.theta, currents, plant.flat_top)
    lines = rotor_lines(
        turns, np.column_stack([turns.samples[:, MOTOR_SPEED], q]), HARMONICS
    )
    speed, mean = lines[0, 0].real, lines[0, 1].real
    if turns.direction * mean <= 0.0:
        raise IncompleteRecordError(
            f"mean torque current {mean:.3g} A against the sense of rotation: the motor was "
            "driven from outside, repeat the test without load"
        )
    s = 1j * np.arange(1, HARMONICS + 1) * speed
    load = plant.surface_inertia * s**2 + plant.surface_viscous_friction * s
    spring = plant.shaft_stiffness + plant.shaft_damping * s
    behind = spring * load / (spring + load) / plant.gear_ratio**2 / s
    torque = (plant.motor_inertia * s + behind) * lines[1:, 0]
    scale = 2.0 * plant.back_emf_constant
    residual = (torque - scale * lines[1:, 1]) / (scale * mean)
    return TorqueLines(residual, float(abs(mean)), float(abs(speed)))
