"""Strangers that no entry of the catalogue describes: another controller, another sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ema_record.actuator import Actuator
from ema_record.channels import MOTOR_SPEED, PHASE_CURRENTS, ROTOR_ANGLE, SURFACE_POSITION
from ema_record.record import Record


@dataclass(frozen=True, slots=True)
class Foreign:
    """A change that the catalogue does not know, and the ports where it may be said to live."""

    ports: tuple[str, ...]
    text: str


FOREIGN: dict[str, Foreign] = {
    "integral_gain": Foreign(("controller",), "integral gain of the speed control × 0.3"),
    "proportional_gain": Foreign(("controller",), "proportional gain of the speed control × 0.4"),
    "speed_limit": Foreign(("controller",), "speed limit × 0.85"),
    "current_limit": Foreign(("controller", "supply"), "current limit 13 A for 22 A"),
    "inductance": Foreign(("winding",), "inductance of all phases × 1.6"),
    "hysteresis": Foreign(("controller", "supply"), "current band of ±1.5 A for ±0.5 A"),
    "speed_display": Foreign(("sensor",), "recorded speed 4 % high, the loop's is right"),
    "resolver": Foreign(("sensor", "commutation"),
                        "rotor angle as recorded off by 0.05 rad, twice a turn"),
    "crosstalk": Foreign(("sensor",), "8 % of current a recorded in b"),
    "position_linearity": Foreign(("sensor",), "recorded position off by 2 mrad, 5 periods a rad"),
}


def foreign_actuator(kind: str, a: Actuator) -> Actuator:
    """Return the actuator with the change, where it is one of the actuator."""
    c = a.control
    if kind == "integral_gain":
        return a._replace(control=c._replace(integral_gain=0.3 * c.integral_gain))
    if kind == "proportional_gain":
        return a._replace(control=c._replace(proportional_gain=0.4 * c.proportional_gain))
    if kind == "speed_limit":
        return a._replace(control=c._replace(speed_limit=0.85 * c.speed_limit))
    if kind == "current_limit":
        return a._replace(inverter=a.inverter._replace(current_limit=13.0))
    if kind == "inductance":
        return a._replace(motor=a.motor._replace(
            phase_inductance=1.6 * a.motor.phase_inductance))
    if kind == "hysteresis":
        return a._replace(inverter=a.inverter._replace(hysteresis=1.5))
    return a


def foreign_record(kind: str, record: Record) -> Record:
    """Return the record with the change, where it is one of the acquisition."""
    x = record.samples.copy()
    if kind == "speed_display":
        x[:, MOTOR_SPEED] *= 1.04
    elif kind == "resolver":
        x[:, ROTOR_ANGLE] = np.mod(
            x[:, ROTOR_ANGLE] + 0.05 * np.sin(2.0 * x[:, ROTOR_ANGLE]), 2.0 * np.pi)
    elif kind == "crosstalk":
        currents = x[:, PHASE_CURRENTS]
        currents[:, 1] += 0.08 * currents[:, 0]
        x[:, PHASE_CURRENTS] = currents
    elif kind == "position_linearity":
        x[:, SURFACE_POSITION] += 2e-3 * np.sin(10.0 * np.pi * x[:, SURFACE_POSITION])
    else:
        return record
    return replace(record, samples=x)
