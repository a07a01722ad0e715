"""Drives with a carrier: whether they can work, and whether a record shows the carrier."""

from __future__ import annotations

import math

from ema_record.actuator import INSTANT, RELAY, Actuator
from ema_record.errors import UsageError

LEAST_PERIODS = 12.0
"""Periods of the carrier an electrical turn at the speed limit: two a sector of six."""


def most_gain(a: Actuator) -> float:
    """Return the bound of K_p + K_i / 2f (V/A) below which the current control is stable.

    The winding with its voltage held over a period T = 1/f of the carrier is
    i' = α i + (1 - α)/R u with α = exp(-R T / L); the Jury criterion for it under
    u = K_p e + x, x' = x + K_i T e gives R (1 + α)/(1 - α), for small R T / L about 2 L f.
    """
    r = a.motor.phase_resistance
    kept = math.exp(-r / (a.motor.phase_inductance * a.drive.pwm_frequency))
    return r * (1.0 + kept) / (1.0 - kept)


def shows_carrier(a: Actuator, rate: float) -> bool:
    """Return whether samples at a rate (1/s) see the carrier, so that its edges matter.

    A mean over whole periods does not, nor do instants where a period begins or in its middle:
    there the ripple of centred pulses crosses its mean.
    """
    if a.drive.kind == RELAY:
        return False
    q = a.acquisition
    places = [a.drive.pwm_frequency / rate]
    if q.sampling == INSTANT:
        places.append(2.0 * q.time_at * places[0])
    return places[0] < 0.5 or any(abs(x - round(x)) > 1e-6 for x in places)


def check_drive(a: Actuator) -> None:
    """Raise UsageError where the drive has a carrier and cannot work."""
    d = a.drive
    if d.kind == RELAY:
        return
    turns = a.motor.pole_pairs * a.control.speed_limit / (2.0 * math.pi)
    if d.pwm_frequency < LEAST_PERIODS * turns:
        raise UsageError(
            f"drive.pwm_frequency {d.pwm_frequency:g} /s: at the speed limit the motor makes "
            f"{turns:.4g} electrical turns a second, each needs {LEAST_PERIODS:g} periods or "
            f"more: at least {math.ceil(LEAST_PERIODS * turns)} /s"
        )
    if d.proportional_gain == 0.0:
        raise UsageError(
            "drive.proportional_gain 0 V/A: the current control needs one above 0; a third of "
            f"its bound is {most_gain(a) / 3.0:.3g} V/A"
        )
    gain = d.proportional_gain + 0.5 * d.integral_gain / d.pwm_frequency
    if gain >= most_gain(a):
        raise UsageError(
            f"drive: proportional_gain {d.proportional_gain:g} V/A with integral_gain "
            f"{d.integral_gain:g} V/(A s): not stable at pwm_frequency {d.pwm_frequency:g} /s, "
            f"Kp + Ki / 2f must be below {most_gain(a):.3g} V/A: lower them or raise the frequency"
        )
