"""The description of an actuator from a data sheet: each value given, derived or assumed.

What a data sheet does not say is assumed in proportion to what it says, as it is in geared servo
actuators; acceptance records correct it (`ema commission`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, get_type_hints

from ema_record.actuator import PARTS, Actuator, actuator_from
from ema_record.data_sheet.constants import FLAT_TOP, phase_constant
from ema_record.data_sheet.gains import current_gains, motion_gains, relay_band
from ema_record.data_sheet.quantities import RPM
from ema_record.data_sheet.sheet import DataSheet
from ema_record.errors import UsageError
from ema_record.profiles.motion import free_speed, torque_constant

GIVEN, DERIVED, ASSUMED = "given", "derived", "assumed"
STAGE, STAGE_EFFICIENCY = 6.0, 0.9
"""Ratio of a planetary stage, and its efficiency (gear catalogues: 0.85 to 0.92)."""
SPEED_SHARE = 0.6
"""Of the speed at which the back-EMF takes the whole bus: room for load, heat and a low bus."""
DRY, VISCOUS_SHARE, STATIC = 0.05, 0.25, 4.0 / 3.0
"""Dry friction of motor and gear, of the torque; viscous at the speed limit and static, of it."""
LOAD, LOAD_STATIC = 0.05, 1.5
"""Dry friction of the surface, of the gear's torque; static, of it."""
LOAD_INERTIA, TWIST, DAMPING, PLAY = 0.05, math.radians(0.5), 0.1, 0.01
"""Inertia of the surface, of the rotor's, both at the motor; twist of the shaft at full torque
(rad); its damping, of critical; lost motion, of the twist."""
PERIOD = 50e-6
RECORDER = "usual; see the recorder's sheet"


class Entry(NamedTuple):
    """A parameter and where it is from."""

    value: Any
    origin: str
    """given, derived or assumed."""
    how: str


class Description(NamedTuple):
    """An actuator with the origin of each parameter."""

    actuator: Actuator
    entries: dict[str, dict[str, Entry]]
    """By section and parameter."""


def bounds_of(section: str, name: str) -> tuple[float, float, str]:
    """Return the bounds of a parameter of the model, and its unit."""
    field = get_type_hints(PARTS[section], include_extras=True)[name].__metadata__[-1]
    limits = {type(item).__name__: item for item in field.metadata}
    unit = (field.json_schema_extra or {}).get("unit", "1")
    return limits["Ge"].ge, getattr(limits.get("Le"), "le", math.inf), unit


class _Book:
    """Entries as they come."""

    def __init__(self) -> None:
        self.entries: dict[str, dict[str, Entry]] = {section: {} for section in PARTS}

    def put(self, where: str, value: Any, origin: str, how: str) -> Any:
        """Enter a parameter, `where` as section.name; a value that is assumed keeps its bounds."""
        section, name = where.split(".")
        if origin == ASSUMED and isinstance(value, float):
            least, most, _ = bounds_of(section, name)
            if not least <= value <= most:
                value, how = min(max(value, least), most), f"{how}; the nearest the model takes"
            value = float(f"{value:.3g}")  # it is not known better
        elif isinstance(value, float) and origin == GIVEN:
            value = float(f"{value:.9g}")  # without the dust of its unit
        self.entries[section][name] = Entry(value, origin, how)
        return value

    def either(self, sheet: DataSheet, option: str, where: str, default: float, how: str) -> Any:
        """Enter what the data sheet states, else what is assumed."""
        if sheet.has(option):
            return self.put(where, sheet.given[option].value, GIVEN,
                            f"--{option} {sheet.given[option].text}")
        return self.put(where, default, ASSUMED, how)

    def actuator(self, sections: tuple[str, ...] = tuple(PARTS)) -> Actuator:
        """Return the actuator of what was entered so far."""
        data = {section: {name: entry.value for name, entry in self.entries[section].items()}
                for section in sections}
        return actuator_from(data, "the data sheet")


def describe(sheet: DataSheet) -> Description:
    """Return the description of the actuator of a data sheet.

    Raises
    ------
    UsageError
        The statements contradict each other, or the model cannot hold them.
    """
    book = _Book()
    drive = sheet.drive or ("foc" if sheet.shape == "sine" else "pwm")
    book.put("drive.kind", drive, GIVEN if sheet.drive else ASSUMED,
             f"--drive {drive}" if sheet.drive else f"usual with a {sheet.shape} back-EMF")
    limit = _electrical(book, sheet)
    ratio, efficiency = _gear(book, sheet)
    period = book.either(sheet, "control-period", "control.period", PERIOD,
                         "usual in servo drives")
    # What the torque is needs the drive and the winding alone.
    so_far = book.actuator(("inverter", "motor", "drive"))
    k_t, free = torque_constant(so_far), free_speed(so_far)
    speed = _speed(book, sheet, free)
    torque = book.put("motor.torque_limit",
                      sheet.value("peak-torque", float(f"{k_t * limit:.6g}")),
                      *((GIVEN, f"--peak-torque {sheet.given['peak-torque'].text}")
                        if sheet.has("peak-torque") else
                        (DERIVED, f"torque of the current limit, {k_t:.4g} N m/A")))
    torque = min(torque, k_t * limit)
    _friction(book, sheet, k_t, torque, speed)
    rotor = _inertia(book, sheet)
    _surface(book, sheet, torque * ratio * efficiency, rotor, ratio, speed)
    _recording(book, sheet, limit, speed, period)
    current_gains(book.put, sheet, so_far, period)
    relay_band(book.put, sheet, so_far, drive)
    for name in ("position_gain", "proportional_gain", "integral_gain"):  # not known before
        book.put(f"control.{name}", 1.0, DERIVED, "")
    motion_gains(book.put, book.actuator())
    return Description(book.actuator(), book.entries)


def _electrical(book: _Book, sheet: DataSheet) -> float:
    """Enter winding and inverter; return the limit of the current (A)."""
    for option, name in (("resistance", "phase_resistance"), ("inductance", "phase_inductance")):
        text = sheet.given[option].text
        book.put(f"motor.{name}", 0.5 * sheet.given[option].value, GIVEN,
                 f"--{option} {text} between terminals, halved: two phases of a star")
    bus = sheet.given["bus"]
    k, how = phase_constant(sheet.given, sheet.shape, sheet.voltage_is, sheet.current_is,
                            bus.value)
    book.put("motor.back_emf_constant", float(f"{k:.9g}"), DERIVED, how)
    for phase in "abc":
        book.put(f"motor.back_emf_deviation_{phase}", 0.0, ASSUMED, "equal phases")
    book.put("motor.back_emf", "trapezoid" if sheet.shape == "trapezoid" else "harmonics",
             GIVEN if sheet.shape_given else ASSUMED,
             f"--shape {sheet.shape}" if sheet.shape_given else "a sine, as in most servo motors")
    book.put("motor.flat_top", FLAT_TOP, DERIVED, "120 deg, of block commutation; of a trapezoid")
    for order in (3, 5, 7):
        book.put(f"motor.harmonic_{order}", 0.0, ASSUMED, "of the fundamental; a pure sine")
    book.put("motor.pole_pairs", int(sheet.given["pole-pairs"].value), GIVEN,
             f"--pole-pairs {sheet.given['pole-pairs'].text}")
    book.put("inverter.bus_voltage", 0.5 * bus.value, GIVEN,
             f"--bus {bus.text} between the rails: a leg switches between + and - half of it")
    limit = sheet.given["current-limit"]
    book.put("inverter.current_limit", limit.value, GIVEN, f"--current-limit {limit.text}")
    return limit.value


def _gear(book: _Book, sheet: DataSheet) -> tuple[float, float]:
    """Enter the gear and the stroke; return ratio and efficiency."""
    ratio = book.put("gear.ratio", sheet.given["gear"].value, GIVEN,
                     f"--gear {sheet.given['gear'].text}")
    stages = max(math.ceil(math.log(ratio) / math.log(STAGE) - 1e-9), 0)
    efficiency = book.either(
        sheet, "gear-efficiency", "gear.efficiency", STAGE_EFFICIENCY**stages,
        f"{STAGE_EFFICIENCY} a stage of up to {STAGE:g}, {stages} stages")
    book.put("surface.end_stop", sheet.given["end-stop"].value, GIVEN,
             f"--end-stop {sheet.given['end-stop'].text}")
    return ratio, efficiency


def _speed(book: _Book, sheet: DataSheet, free: float) -> float:
    """Enter and return the limit of the motor's speed (rad/s)."""
    speed: float = book.either(sheet, "speed", "control.speed_limit", SPEED_SHARE * free,
                               f"{SPEED_SHARE:g} of {free / RPM:.0f} rpm, where the back-EMF "
                               "takes the whole bus")
    if speed >= free:
        raise UsageError(
            f"--speed {sheet.given['speed'].text}: the back-EMF at this speed exceeds the bus of "
            f"{sheet.given['bus'].text}: below {free / RPM:.0f} rpm ({free:.4g} rad/s), or a "
            "higher bus")
    return speed


def _friction(book: _Book, sheet: DataSheet, k_t: float, torque: float, speed: float) -> None:
    """Enter friction of motor and gear, at the motor."""
    dry, how = DRY * torque, f"{DRY:g} of the largest torque"
    viscous = None
    if sheet.has("no-load-current") and not sheet.has("friction"):
        idle = sheet.given["no-load-current"]
        at = sheet.value("no-load-speed", speed / SPEED_SHARE)
        dry = 0.5 * k_t * idle.value
        viscous = dry / at
        how = f"half the torque of --no-load-current {idle.text}; a gear adds to it"
    dry = book.either(sheet, "friction", "motor.dynamic_friction", dry, how)
    if viscous is None:
        viscous = VISCOUS_SHARE * dry / speed
    book.either(sheet, "viscous-friction", "motor.viscous_friction", viscous,
                how if how.startswith("half") else
                f"{VISCOUS_SHARE:g} of the dry friction at the speed limit")
    book.put("motor.static_friction", STATIC * dry, ASSUMED, "4/3 of the dynamic one")


def _inertia(book: _Book, sheet: DataSheet) -> float:
    """Enter and return the inertia of rotor and gear (kg m²)."""
    rotor, gear = sheet.given["inertia"], sheet.value("gear-inertia", 0.0)
    how = f"--inertia {rotor.text}" + (
        f" and --gear-inertia {sheet.given['gear-inertia'].text}" if gear else
        " of the rotor; the gear's, where there is much, is added with --gear-inertia")
    return float(book.put("motor.inertia", rotor.value + gear, GIVEN, how))


def _surface(
    book: _Book, sheet: DataSheet, torque: float, rotor: float, ratio: float, speed: float
) -> None:
    """Enter surface and shaft; `torque` is the gear's largest (N m)."""
    inertia = book.either(sheet, "surface-inertia", "surface.inertia",
                          LOAD_INERTIA * rotor * ratio**2,
                          f"{LOAD_INERTIA:g} of the rotor's at the gear's output")
    dry = book.either(sheet, "surface-friction", "surface.dynamic_friction", LOAD * torque,
                      f"{LOAD:g} of the gear's largest torque, {torque:.3g} N m")
    book.put("surface.viscous_friction", LOAD * dry * ratio / speed, ASSUMED,
             f"{LOAD:g} of the dry friction at the slew speed")
    book.put("surface.static_friction", LOAD_STATIC * dry, ASSUMED,
             f"{LOAD_STATIC:g} of the dynamic one")
    stiffness = book.either(sheet, "stiffness", "shaft.stiffness", torque / TWIST,
                            "the gear's largest torque twists it by half a degree")
    book.put("shaft.damping", 2.0 * DAMPING * math.sqrt(stiffness * inertia), ASSUMED,
             f"{DAMPING:g} of critical, of the surface on the shaft")
    book.either(sheet, "backlash", "shaft.backlash", PLAY * TWIST,
                f"{PLAY:g} of that half degree")


def _recording(
    book: _Book, sheet: DataSheet, limit: float, speed: float, period: float
) -> None:
    """Enter converters, noise and acquisition."""
    stop = sheet.given["end-stop"].value
    for name, span, bits, how in (
        ("position", 3.2 * stop, 14, "the stroke and room"),
        ("speed", 2.5 * speed, 14, "+ and - the speed limit and room"),
        ("current", 2.8 * limit, 16, "+ and - the current limit and room"),
        ("angle", 8.0, 16, "a turn and room"),
    ):
        book.put(f"converters.{name}_range", span, ASSUMED, how)
        book.put(f"converters.{name}_bits", bits, ASSUMED, RECORDER)
    book.put("converters.speed_offset", 0.0, ASSUMED, "steps; it rounds, -0.5: it truncates")
    for name, size, how in (
        ("speed", speed / 1600.0, "1/1600 of the speed limit; records measure it"),
        ("current", limit / 440.0, "1/440 of the current limit; records measure it"),
        ("position", stop / 30_000.0, "1/30000 of the way to the end stop; records measure it"),
    ):
        book.put(f"noise.{name}", size, ASSUMED, how)
    rate = book.either(sheet, "rate", "acquisition.rate", 1.0 / period,
                       "a sample a control period")
    book.put("acquisition.view_rate", rate / 10.0, ASSUMED, "a tenth of the rate, for people")
    book.put("acquisition.sampling", "mean", ASSUMED, RECORDER)
    book.put("acquisition.time_at", 0.5, ASSUMED, "in the middle of a sample")
    for name, how in (("command", "see tolerances"), ("reference", "see tolerances"),
                      ("commutation", "records measure it")):
        book.put(f"acquisition.{name}_latency", 0.0, ASSUMED, f"in control periods; {how}")
    book.put("acquisition.converters", True, ASSUMED, RECORDER)
    for channel in ("phase_current_c", "reference_currents", "rotor_angle", "surface_position"):
        book.put(f"acquisition.{channel}", channel not in sheet.without,
                 GIVEN if channel in sheet.without else ASSUMED,
                 f"--without {channel}" if channel in sheet.without else "it is recorded")
