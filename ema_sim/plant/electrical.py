"""Electrical equations: back-EMF shape, commutation (Table 1), phase model.

Phases a, b, c in star with floating neutral::

    L_k di_k/dt = v_k − v_n − R_k i_k − e_k,   e_k = k_k(θ) ω,   T_M = Σ k_k(θ) i_k
    v_n = Σ(x_k / L_k) / Σ(1 / L_k),           x_k = v_k − R_k i_k − e_k

(Pillay and Krishnan 1989, IEEE Trans. Ind. Appl. 25(2); eqs. 1 and 2 of Battipede et al. are the
case of equal phases.) θ is the electrical angle, ω
the mechanical speed: with p pole pairs θ turns at p ω, and k is the same for any p.
"""

from __future__ import annotations

import math

from ema_sim.effects.compile import law
from ema_sim.machine import FIRST_EDGE, QUARTER, SECTOR, TURN

ROOT_3_HALF = 0.5 * math.sqrt(3.0)
BEYOND_EDGE = 1e-9
NO_SLOPE = 1e-150
"""Stands for no slope towards the band (A/s)."""
MOST_BEND = 0.5
"""Limit of the second-order part of a time to a crossing, of the first."""


@law
def wrap(theta: float) -> float:
    """Return the angle in [0, 2π)."""
    return theta - TURN * math.floor(theta / TURN)


@law
def trapezoid(theta: float, flat_top: float) -> float:
    """Return the unit trapezoid at electrical angle `theta` in [-2π, 2π] (rad).

    The positive flat top, `flat_top` wide (rad), is centred at π/2; zero at 0 and π.
    """
    beyond = theta - QUARTER
    beyond = beyond - TURN if beyond > math.pi else beyond
    beyond = beyond + TURN if beyond < -math.pi else beyond
    value = (QUARTER - abs(beyond)) * (2.0 / (math.pi - flat_top))
    value = min(value, 1.0)
    return max(value, -1.0)


@law
def harmonics(sine: float, third: float, fifth: float, seventh: float) -> float:
    """Return sin θ + h3 sin 3θ + h5 sin 5θ + h7 sin 7θ, given sin θ and the h (1)."""
    x = sine * sine
    return sine * (
        1.0 + third * (3.0 - 4.0 * x) + fifth * (5.0 + x * (16.0 * x - 20.0))
        + seventh * (7.0 + x * (x * (112.0 - 64.0 * x) - 56.0))
    )


@law
def of_phases(sine: float, cosine: float) -> tuple[float, float, float]:
    """Return sin(θ - φ_k) of phases a, b, c, given sin θ and cos θ."""
    half, far = -0.5 * sine, ROOT_3_HALF * cosine
    return sine, half - far, half + far


@law
def sector_ahead(theta: float, direction: float) -> tuple[int, float]:
    """Return the commutation sector 0..5 (0 is 30° to 90°), and the angle to its end.

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
def sectors_ahead(theta: float, lag: float, direction: float) -> tuple[int, int, float]:
    """Return the sector, the one in which the currents are driven, the angle to the next end.

    Parameters
    ----------
    theta, direction : as in `sector_ahead`.
    lag : angle (rad) that the rotor turns in the time until a change of sector acts.
    """
    sector, gap = sector_ahead(theta, direction)
    if lag == 0.0:
        return sector, sector, gap
    acting, other = sector_ahead(theta - lag, direction)
    return sector, acting, min(gap, other)


@law
def relay(leg: float, excess: float, band: float) -> float:
    """Return the state ±1 of a leg: the hysteresis relay of its phase.

    Parameters
    ----------
    leg : state so far.
    excess : current above its reference (A).
    band : half width of the hysteresis (A).
    """
    leg = -1.0 if excess >= band else leg
    return 1.0 if excess <= -band else leg


@law
def time_to_switch(
    leg: float, excess: float, slope: float, change: float, band: float
) -> float:
    """Return the time to the relay's crossing (s), huge if the current moves away from it.

    Parameters
    ----------
    leg, excess, band : as in `relay`, which has looked: the current is within the band.
    slope, change : of the current (A/s), of its slope (A/s²).
    """
    towards = leg * slope
    per = 1.0 / (max(NO_SLOPE, towards))
    reach = (band - leg * excess) * per
    bend = (0.5 * leg * change) * (per * reach)
    bend = min(bend, MOST_BEND)
    bend = max(bend, -MOST_BEND)
    return reach - bend * reach


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
