"""Electrical equations: back-EMF shape, commutation (Table 1), phase model.

Phases a, b, c in star with floating neutral::

    L_k di_k/dt = v_k − v_n − R_k i_k − e_k,   e_k = k_k(θ) ω,   T_M = Σ k_k(θ) i_k
    v_n = Σ(x_k / L_k) / Σ(1 / L_k),           x_k = v_k − R_k i_k − e_k

(DESIGN, section 3; the paper's eqs. 1 and 2 are the case of equal phases.)
"""

from __future__ import annotations

import math

from ema_sim.compile import law

TURN = 2.0 * math.pi
THIRD = TURN / 3.0
SECTOR = math.pi / 3.0
FIRST_EDGE = math.pi / 6.0
BEYOND_EDGE = 1e-9


@law
def wrap(theta: float) -> float:
    """Return the angle in [0, 2π)."""
    return theta - TURN * math.floor(theta / TURN)


@law
def trapezoid(theta: float, flat_top: float) -> float:
    """Return the unit trapezoid at electrical angle `theta` in [0, 2π) (rad).

    The positive flat top, `flat_top` wide (rad), is centred at π/2; zero at 0 and π.
    """
    ramp = 0.5 * (math.pi - flat_top)
    x = theta
    sign = 1.0
    if x >= math.pi:
        x -= math.pi
        sign = -1.0
    if x < ramp:
        return sign * x / ramp
    if x > math.pi - ramp:
        return sign * (math.pi - x) / ramp
    return sign


@law
def sector_of(theta: float) -> int:
    """Return the commutation sector 0..5 of the paper's Table 1; sector 0 is 30° to 90°."""
    return math.floor((theta - FIRST_EDGE) / SECTOR) % 6


@law
def sector_ahead(theta: float, direction: float) -> tuple[int, float]:
    """Return the commutation sector and the angle to its end (rad).

    Parameters
    ----------
    theta : angle of the commutation sensor (rad).
    direction : +1 or -1, of the rotation; on an edge (to 1e-9) the sector that it enters.
    """
    place = (theta - FIRST_EDGE) * (1.0 / SECTOR)
    floor = math.floor(place + direction * BEYOND_EDGE)
    gap = floor + 1.0 - place if direction > 0.0 else place - floor
    return int(floor) % 6, (gap + BEYOND_EDGE) * SECTOR


@law
def reference_signs(sector: int) -> tuple[float, float, float]:
    """Return the signs of the reference currents a, b, c in a sector (paper, Table 1)."""
    if sector == 0:
        return 1.0, -1.0, 0.0
    if sector == 1:
        return 1.0, 0.0, -1.0
    if sector == 2:
        return 0.0, 1.0, -1.0
    if sector == 3:
        return -1.0, 1.0, 0.0
    if sector == 4:
        return -1.0, 0.0, 1.0
    return 0.0, -1.0, 1.0
