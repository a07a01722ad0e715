"""The controller, once a control period: position P, speed PI, limits (DESIGN, section 3)."""

from __future__ import annotations

import math

from ema_sim.compile import law


@law
def clip(value: float, limit: float) -> float:
    """Return `value` limited to ±`limit`."""
    if value > limit:
        return limit
    if value < -limit:
        return -limit
    return value


@law
def quantise(value: float, step: float, span: float) -> float:
    """Return what a converter with this `step` over ±`span`/2 reads, saturated at its ends."""
    return clip(step * math.floor(value / step + 0.5), 0.5 * span)


@law
def speed_control(
    error: float, integral: float, kp: float, ki: float, period: float, limit: float
) -> tuple[float, float]:
    """Return reference current (A) and new integral (A) of the PI speed control.

    Conditional integration: the integral stops while the output is limited and the error
    drives it further.
    """
    grown = integral + ki * error * period
    current = kp * error + grown
    if (current > limit and error > 0.0) or (current < -limit and error < 0.0):
        grown = integral
        current = kp * error + grown
    return clip(current, limit), grown
