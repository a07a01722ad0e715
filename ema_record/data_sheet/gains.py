"""Gains of the controls, by stated rules.

Each loop is slow against the one inside it, and the innermost against its sampling: the current
loop against the carrier, the speed loop against the control period and the current loop, the
position loop against the speed loop and against the torque that must brake the motor (cascade
control: Krishnan, 2010, chapter 9; Schröder, Elektrische Antriebe - Regelung, 2015).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from ema_record.actuator import RELAY, Actuator
from ema_record.data_sheet.sheet import DataSheet
from ema_record.errors import UsageError
from ema_record.profiles.motion import motion, torque_constant

Put = Callable[[str, Any, str, str], Any]
"""Enters a parameter: section.name, value, origin, how."""
CURRENT = 15.0
"""The current loop's bandwidth is the carrier's angular frequency over this."""
PERIODS, INSIDE = 14.0, 4.0
"""The speed loop takes so many control periods, and is so many times slower than the current
loop."""
STIFF = 20.0
"""Largest gain: the current limit at 1/20 of the speed limit. More would answer to the noise."""
INTEGRAL = 7.0
"""The integral of the speed control acts so many times slower than its gain."""
OUTSIDE, BRAKING, RESONANCE = 20.0, 0.5, 5.0
"""The position loop is so many times slower than the speed loop; it brakes with half the torque;
it is so many times slower than the surface on its shaft."""
SWITCHING, LEAST_BAND, MOST_BAND = 40e3, 1.0 / 44.0, 1.0 / 5.0
"""Highest frequency of a relay (Hz); band of the current limit, usual and most."""
DERIVED, ASSUMED, GIVEN = "derived", "assumed", "given"


def current_gains(put: Put, sheet: DataSheet, actuator: Actuator, period: float) -> None:
    """Enter carrier and gains of the current control: its zero on the winding's pole."""
    if sheet.has("pwm"):
        carrier = sheet.given["pwm"].value
        put("drive.pwm_frequency", carrier, GIVEN, f"--pwm {sheet.given['pwm'].text}")
    else:
        carrier = put("drive.pwm_frequency", 1.0 / period, ASSUMED, "one a control period")
    bandwidth = 2.0 * math.pi * carrier / CURRENT
    motor = actuator.motor
    put("drive.proportional_gain", float(f"{bandwidth * motor.phase_inductance:.4g}"), DERIVED,
        f"bandwidth {bandwidth:.4g} rad/s, the carrier over {CURRENT:g}, times L")
    put("drive.integral_gain", float(f"{bandwidth * motor.phase_resistance:.4g}"), DERIVED,
        "the same times R")
    put("drive.modulation", "circle", ASSUMED, "usual; of pwm and foc: hexagon, circle or sine")


def relay_band(put: Put, sheet: DataSheet, actuator: Actuator, drive: str) -> None:
    """Enter the band of a relay: at standstill it switches with V / (4 h L).

    Raises
    ------
    UsageError
        The inductance is so small that the band would be a good part of the current.
    """
    limit, v = actuator.inverter.current_limit, actuator.inverter.bus_voltage
    if sheet.has("hysteresis"):
        put("inverter.hysteresis", sheet.given["hysteresis"].value, GIVEN,
            f"--hysteresis {sheet.given['hysteresis'].text}")
        return
    needed = v / (4.0 * SWITCHING * actuator.motor.phase_inductance)
    if drive == "relay" and needed > MOST_BAND * limit:
        raise UsageError(
            f"--drive relay with --inductance {sheet.given['inductance'].text}: to switch at "
            f"{SWITCHING * 1e-3:g} kHz its band would be +-{needed:.3g} A of {limit:g} A: it is "
            "no relay drive (--drive pwm or foc), or give --hysteresis")
    put("inverter.hysteresis", max(needed, LEAST_BAND * limit), ASSUMED,
        f"1/44 of the current limit, {SWITCHING * 1e-3:g} kHz at most; of a relay drive")


def motion_gains(put: Put, actuator: Actuator) -> None:
    """Enter the gains of speed and position control; the actuator's own are not looked at."""
    at, control = motion(actuator), actuator.control
    k_t = torque_constant(actuator)
    stiffest = STIFF * k_t * actuator.inverter.current_limit / (at.inertia * control.speed_limit)
    bounds = {
        f"{PERIODS:g} control periods": 1.0 / (PERIODS * control.period),
        f"the current limit at 1/{STIFF:g} of the speed limit": stiffest,
    }
    if actuator.drive.kind != RELAY:
        bounds[f"1/{INSIDE:g} of the current loop"] = (
            2.0 * math.pi * actuator.drive.pwm_frequency / CURRENT / INSIDE)
    why, bandwidth = min(bounds.items(), key=lambda item: item[1])
    gain = bandwidth * at.inertia / k_t
    put("control.proportional_gain", float(f"{gain:.4g}"), DERIVED,
        f"bandwidth {bandwidth:.4g} rad/s ({why}) times J / k_T")
    put("control.integral_gain", float(f"{gain * bandwidth / INTEGRAL:.4g}"), DERIVED,
        f"the same times bandwidth / {INTEGRAL:g}")
    shaft = math.sqrt(actuator.shaft.stiffness / actuator.surface.inertia)
    bounds = {
        f"1/{OUTSIDE:g} of the speed loop": bandwidth / OUTSIDE,
        "braking with half the torque": BRAKING / at.acceleration,
        f"1/{RESONANCE:g} of the surface on its shaft": shaft / RESONANCE,
    }
    why, outer = min(bounds.items(), key=lambda item: item[1])
    put("control.position_gain", float(f"{outer * actuator.gear.ratio:.4g}"), DERIVED,
        f"{outer:.4g} 1/s ({why}) times the gear ratio")
