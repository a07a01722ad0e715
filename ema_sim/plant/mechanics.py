"""Mechanical equations: dry friction, shaft with stiffness, damping and backlash."""

from __future__ import annotations

from ema_sim.effects.compile import law


@law
def net_torque(omega: float, torque: float, dynamic: float, static: float) -> float:
    """Return the torque that accelerates a body with dry friction (N m).

    While it moves the dynamic torque opposes the speed `omega`; at standstill the active
    `torque` must exceed the static one to start it (Borello and Dalla Vedova).
    """
    if omega > 0.0:
        return torque - dynamic
    if omega < 0.0:
        return torque + dynamic
    if torque > static:
        return torque - dynamic
    if torque < -static:
        return torque + dynamic
    return 0.0


@law
def shaft_torque(
    twist: float, twist_rate: float, stiffness: float, damping: float, backlash: float
) -> float:
    """Return the torque of the shaft on the surface (N m).

    Parameters
    ----------
    twist : gear output minus surface position (rad).
    twist_rate : its rate (rad/s).
    stiffness, damping : of the shaft (N m/rad, N m s/rad).
    backlash : total lost motion (rad); inside it the torque is zero, and contact only pushes.
    """
    half = 0.5 * backlash
    if twist > half:
        return max(0.0, stiffness * (twist - half) + damping * twist_rate)
    if twist < -half:
        return min(0.0, stiffness * (twist + half) + damping * twist_rate)
    return 0.0
