"""The controller, once a control period: position P, speed PI, limits."""

from __future__ import annotations

import math

import numpy as np

from ema_record.actuator import Control
from ema_sim.effects.compile import law

NEVER = math.inf


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
    return clip(step * np.floor(value * (1.0 / step) + 0.5), 0.5 * span)


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


@law
def reference_current(
    c: Control, limit: float, command: float, position: float, speed: float, integral: float
) -> tuple[float, float]:
    """Return reference current (A) and new integral (A) of one control period.

    Parameters
    ----------
    c : gains and limits.
    limit : of the current (A).
    command, position : of the surface (rad), commanded and measured.
    speed : of the motor, measured (rad/s).
    integral : of the speed control (A).
    """
    wanted = clip(c.position_gain * (command - position), c.speed_limit)
    return speed_control(
        wanted - speed, integral, c.proportional_gain, c.integral_gain, c.period, limit
    )


@law
def arriving(
    history: np.ndarray, tick: int, whole: int, part: float, now: float, present: float
) -> tuple[float, float, float]:
    """Return a late value of this control period: what holds, what follows, and when (s).

    A delay is a shift in time: what is a whole number of periods and a `part` late takes the
    place of the present value within the period.

    Parameters
    ----------
    history : ring of past values, shape (n,), ``n > whole``, that of this period included.
    tick : number of this period.
    whole, part : delay in periods, and what is left of it (s).
    now : begin of the period (s).
    present : the value until now.
    """
    newest = history[(tick - whole) % len(history)]
    if part == 0.0:
        return newest, newest, NEVER
    return present, newest, now + part
