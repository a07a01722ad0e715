"""What the plant and the analysis of records share of the machine; nothing here is compiled.

Angles of a three-phase machine and of its six sectors, the shape of the back-EMF at arrays of
angles, temperature coefficients. `plant.electrical` and `effects.winding_temperature` hold the
compiled laws, which agree with these.
"""

from __future__ import annotations

import math

import numpy as np

from ema_record.actuator import TRAPEZOID, Motor

TURN = 2.0 * math.pi
THIRD = TURN / 3.0
SECTOR = math.pi / 3.0
QUARTER = 0.5 * math.pi
FIRST_EDGE = math.pi / 6.0
"""Where sector 0 of the paper's Table 1 begins (rad)."""
SECTOR_SIGNS = np.rint(
    np.sin(FIRST_EDGE + SECTOR * (np.arange(6)[:, None] + 0.5) - THIRD * np.arange(3))) + 0.0
"""Signs of the reference currents a, b, c in each sector (paper, Table 1), shape (6, 3)."""

REFERENCE = 20.0
"""Temperature of the nominal parameters (degC)."""
COPPER = 0.00393
"""Temperature coefficient of the resistance (1/K), IEC 60028."""
MAGNET = -1.1e-3
"""Temperature coefficient of the back-EMF constant, of NdFeB's remanence (1/K)."""


def unit_trapezoid(theta: np.ndarray, flat_top: float) -> np.ndarray:
    """Return `electrical.trapezoid` at any electrical angles, shape (n,) (rad)."""
    beyond = theta - QUARTER
    beyond -= TURN * np.rint(beyond / TURN)
    return np.clip((QUARTER - np.abs(beyond)) * (2.0 / (np.pi - flat_top)), -1.0, 1.0)


def unit_back_emf(theta: np.ndarray, motor: Motor) -> np.ndarray:
    """Return k(θ) / k of a phase at any electrical angles, shape (n,) (rad)."""
    if motor.back_emf == TRAPEZOID:
        return unit_trapezoid(theta, motor.flat_top)
    found = np.sin(theta)
    for order, part in ((3, motor.harmonic_3), (5, motor.harmonic_5), (7, motor.harmonic_7)):
        if part != 0.0:
            found = found + part * np.sin(order * theta)
    return found
