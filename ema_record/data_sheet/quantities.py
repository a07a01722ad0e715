"""What a data sheet says: quantities with their units and bounds, read from texts such as 0.2 mH.

A unit must be given: data sheets differ in them, and a number without one is guessed wrong sooner
or later.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from ema_record.errors import UsageError

RPM, DEG = 2.0 * math.pi / 60.0, math.pi / 180.0
OHM = {"ohm": 1.0, "mohm": 1e-3}
HENRY = {"H": 1.0, "mH": 1e-3, "uH": 1e-6}
KV = {"rpm/V": RPM, "rad/s/V": 1.0}
BACK_EMF = {"Vs/rad": 1.0, "V/rpm": 1.0 / RPM, "mV/rpm": 1e-3 / RPM, "V/krpm": 1e-3 / RPM}
TORQUE_CONSTANT = {"Nm/A": 1.0, "mNm/A": 1e-3}
AMPERE = {"A": 1.0, "mA": 1e-3}
VOLT = {"V": 1.0}
SPEED = {"rpm": RPM, "rad/s": 1.0, "deg/s": DEG}
INERTIA = {"kgm2": 1.0, "gcm2": 1e-7, "kgcm2": 1e-4}
TORQUE = {"Nm": 1.0, "mNm": 1e-3, "Ncm": 1e-2}
VISCOUS = {"Nms/rad": 1.0, "mNms/rad": 1e-3, "mNm/rpm": 1e-3 / RPM, "Nm/rpm": 1.0 / RPM}
ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": DEG, "arcmin": DEG / 60.0}
STIFFNESS = {"Nm/rad": 1.0, "Nm/deg": 1.0 / DEG, "Nm/arcmin": 60.0 / DEG}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
RATE = {"Hz": 1.0, "kHz": 1e3}
NUMBER: dict[str, float] = {"": 1.0}

MOTOR, GEAR, DRIVE, RECORDER = "Motor", "Gear and surface", "Drive", "Recorder"


class Stated(NamedTuple):
    """A quantity that a data sheet may state."""

    part: str
    """Of the actuator, as in the help."""
    units: dict[str, float]
    """Factors to SI; empty unit: a pure number."""
    least: float
    most: float
    """Bounds (SI) of what is physically meant."""
    example: str
    words: str
    needed: bool = False


QUANTITIES: dict[str, Stated] = {
    "resistance": Stated(
        MOTOR, OHM, 2e-3, 200.0, "1.2ohm", "between two terminals, at 20 degC", True),
    "inductance": Stated(MOTOR, HENRY, 4e-5, 0.2, "0.194mH", "between two terminals", True),
    "kv": Stated(MOTOR, KV, 1e-2, 1e4, "475rpm/V", "speed constant"),
    "back-emf": Stated(
        MOTOR, BACK_EMF, 1e-4, 20.0, "2.107mV/rpm", "voltage constant, line to line"),
    "torque-constant": Stated(MOTOR, TORQUE_CONSTANT, 1e-4, 20.0, "20.1mNm/A", "torque a current"),
    "no-load-speed": Stated(
        MOTOR, SPEED, 1.0, 2e4, "11300rpm",
        "at the nominal voltage; serves as constant, and as check of another"),
    "no-load-current": Stated(MOTOR, AMPERE, 1e-4, 100.0, "0.189A", "at the no-load speed"),
    "nominal-voltage": Stated(
        MOTOR, VOLT, 1.0, 800.0, "24V", "that no-load values are given at; default --bus"),
    "pole-pairs": Stated(MOTOR, NUMBER, 1.0, 50.0, "1", "pairs of poles, not poles", True),
    "inertia": Stated(MOTOR, INERTIA, 1e-8, 10.0, "34gcm2", "of the rotor", True),
    "friction": Stated(MOTOR, TORQUE, 0.0, 1e3, "1.1mNm", "dry, of motor and gear at the motor"),
    "viscous-friction": Stated(
        MOTOR, VISCOUS, 0.0, 10.0, "2.4e-4mNm/rpm", "of motor and gear"),
    "peak-torque": Stated(
        MOTOR, TORQUE, 1e-3, 1e4, "0.15Nm", "of the motor, where it saturates"),
    "gear": Stated(
        GEAR, NUMBER, 1.0, 1e5, "100", "turns of the motor a turn of the surface", True),
    "gear-efficiency": Stated(GEAR, NUMBER, 0.05, 1.0, "0.7", "of the torque"),
    "gear-inertia": Stated(GEAR, INERTIA, 0.0, 10.0, "4gcm2", "at the motor"),
    "stiffness": Stated(
        GEAR, STIFFNESS, 1e2, 1e7, "1.5Nm/arcmin", "of gear and shaft at the output"),
    "backlash": Stated(GEAR, ANGLE, 0.0, 0.1, "1arcmin", "of the gear, total, at its output"),
    "end-stop": Stated(
        GEAR, ANGLE, 0.01, 10.0, "40deg",
        "from the middle to either end stop, half the stroke", True),
    "surface-inertia": Stated(GEAR, INERTIA, 1e-4, 1e4, "2e-3kgm2", "of what the gear turns"),
    "surface-friction": Stated(
        GEAR, TORQUE, 0.0, 1e5, "0.4Nm", "dry, of what the gear turns"),
    "bus": Stated(DRIVE, VOLT, 2.0, 800.0, "24V", "between the rails", True),
    "current-limit": Stated(
        DRIVE, AMPERE, 0.1, 500.0, "7.5A", "of the drive, peak of a phase", True),
    "speed": Stated(
        DRIVE, SPEED, 0.1, 1e4, "6000rpm",
        "limit of the motor's speed; default 0.6 of what the bus allows"),
    "control-period": Stated(DRIVE, TIME, 1e-5, 1e-3, "50us", "of the speed control"),
    "pwm": Stated(DRIVE, RATE, 1e3, 5e5, "40kHz", "frequency of the carrier"),
    "hysteresis": Stated(DRIVE, AMPERE, 0.05, 10.0, "0.2A", "half width of a relay's band"),
    "rate": Stated(RECORDER, RATE, 1e3, 1e6, "10kHz", "samples of the recorder"),
}
"""By the name of the option; bounds are those of the model, doubled where two phases count."""
_TEXT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)")
_SAME = str.maketrans({
    "\u00b5": "u", "\u03bc": "u", "\u03a9": "ohm", "\u2126": "ohm", "\u00b2": "2", "\u00b7": "",
    "*": "", " ": "", "\u00b0": "deg"})
"""Both micro signs, omega and ohm sign, square, dot, degree."""


class Given(NamedTuple):
    """A value off a data sheet."""

    value: float
    """SI."""
    text: str
    """As it was written."""


def read_quantity(name: str, text: str) -> Given:
    """Return the value of an option; UsageError where it has no unit, or is not possible."""
    kind = QUANTITIES[name]
    shown = f"--{name} {text[:40]!r}"
    found = _TEXT.fullmatch(text)
    if found is None:
        raise UsageError(f"{shown}: not a number: give for example {kind.example}")
    written = found[2].translate(_SAME).lower()
    unit = next((u for u in kind.units if u.lower() == written), None)
    if unit is None:
        known = ", ".join(kind.units) or "none"
        what = f"no unit {found[2][:20]!r} here" if written else "the unit is missing"
        if kind.units == NUMBER:
            raise UsageError(f"{shown}: a pure number: give for example {kind.example}")
        raise UsageError(f"{shown}: {what}: give {known}, for example {kind.example}")
    value = float(f"{float(found[1]) * kind.units[unit]:.12g}")  # 10 us are 1e-5
    if not kind.least <= value <= kind.most:
        factor = kind.units[unit]
        raise UsageError(
            f"{shown}: not possible: {kind.words}: {kind.least / factor:.3g} to "
            f"{kind.most / factor:.3g} {unit}".rstrip())
    if name == "pole-pairs" and value != round(value):
        raise UsageError(f"{shown}: pairs of poles are whole: give for example {kind.example}")
    return Given(value, " ".join(text.split()))
