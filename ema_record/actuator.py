"""The description of an actuator: NamedTuples that enter the kernel, with units and bounds.

The bounds are those within which the model is meant to hold; `load_actuator` checks them. The
values stand in the `actuator.yaml` of a kit, those of the default actuator in `config/`, and
nowhere else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_type_hints

from pydantic import BeforeValidator, Field, TypeAdapter

from ema_record.channels import (
    ALL,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
)
from ema_record.errors import UsageError, unknown_name, validated
from ema_record.kit import ACTUATOR, kit_file
from ema_record.limits import MAX_POSITION
from ema_record.yaml_file import load_yaml

NOMINAL = "config/actuator.yaml"
NOISE_RATE = 20_000.0
"""Rate that the values of `Noise` are given for (1/s): white noise is less on a longer mean."""


def quantity(unit: str, lower: float, upper: float, text: str) -> object:
    """Return the pydantic field of a quantity: its unit, bounds and meaning."""
    return Field(ge=lower, le=upper, allow_inf_nan=False, strict=True,  # a yes is no number
                 description=text, json_schema_extra={"unit": unit})


def _count(lower: int, upper: int, text: str) -> object:
    return Field(ge=lower, le=upper, strict=True, description=text,
                 json_schema_extra={"unit": "1"})


def _choice(names: tuple[str, ...], text: str) -> tuple[object, object]:
    """Return the pydantic metadata of a word that the kernel sees as its place in `names`."""
    def code(value: object) -> object:
        if isinstance(value, bool) or (isinstance(value, str) and value not in names):
            raise ValueError(f"{str(value)[:60]!r} is none of {', '.join(names)}")
        return names.index(value) if isinstance(value, str) else value

    return BeforeValidator(code), Field(
        ge=0, lt=len(names), description=text,
        json_schema_extra={"unit": "1", "choices": list(names)})


DRIVES = ("relay", "pwm", "foc", "pwm_independent")
RELAY, PWM, FOC, PWM_INDEPENDENT = range(len(DRIVES))
"""Kinds of drive: a hysteresis relay a phase, or pulse width modulation with PI current controls:
of the phases with six-step references, which share the voltage and leave out what their errors
have in common (`PWM`) or not, or of the rotor's axes with sinusoidal references."""
MODULATIONS = ("hexagon", "circle", "sine")
HEXAGON, CIRCLE, SINE = range(len(MODULATIONS))
"""Voltages of `PWM`, `FOC`: all that centred legs can make, the circle in it, or legs' sines."""
BACK_EMFS = ("trapezoid", "harmonics")
TRAPEZOID, HARMONICS = range(len(BACK_EMFS))
SAMPLINGS = ("mean", "instant")
MEAN, INSTANT = range(len(SAMPLINGS))


def _yes(text: str) -> object:
    """Return the pydantic field of a yes or no, 1 or 0 in the kernel (YAML: true, false)."""
    return Field(ge=0, le=1, description=text, json_schema_extra={"unit": "1"})


_DRIVE = _choice(DRIVES, "kind of current control")
_MODULATION = _choice(MODULATIONS, "voltages that the legs can make together")
_BACK_EMF = _choice(BACK_EMFS, "shape of the back-EMF over the electrical angle")
_SAMPLING = _choice(SAMPLINGS, "what a sample is: the mean over its interval, or one instant")


class Drive(NamedTuple):
    """The current control. A relay needs none of the numbers (its band: `Inverter`)."""

    kind: Annotated[int, _DRIVE[0], _DRIVE[1]]
    pwm_frequency: Annotated[float, quantity("1/s", 1e3, 5e5, "of the carrier")]
    proportional_gain: Annotated[float, quantity("V/A", 0.0, 1e3, "of the current control")]
    integral_gain: Annotated[float, quantity("V/(A s)", 0.0, 1e7, "of the current control")]
    modulation: Annotated[int, _MODULATION[0], _MODULATION[1]] = HEXAGON


class Inverter(NamedTuple):
    """Three half bridges between the rails + and - `bus_voltage`."""

    bus_voltage: Annotated[float, quantity("V", 1.0, 400.0, "leg voltage, + and -")]
    hysteresis: Annotated[float, quantity("A", 0.05, 10.0, "half width of the band")]
    current_limit: Annotated[float, quantity("A", 0.1, 500.0, "limit of the reference")]


class Motor(NamedTuple):
    """Brushless DC motor: three phases in star.

    k(θ) of a phase is `back_emf_constant` times a unit trapezoid, or times
    sin θ + h3 sin 3θ + h5 sin 5θ + h7 sin 7θ.
    """

    phase_resistance: Annotated[float, quantity("Ω", 1e-3, 100.0, "R of a phase")]
    phase_inductance: Annotated[float, quantity("H", 2e-5, 0.1, "L of a phase")]
    back_emf_constant: Annotated[float, quantity("V s/rad", 1e-4, 10.0, "k of a phase")]
    back_emf_deviation_a: Annotated[float, quantity("1", -0.5, 0.5, "relative, of phase a")]
    back_emf_deviation_b: Annotated[float, quantity("1", -0.5, 0.5, "relative, of phase b")]
    back_emf_deviation_c: Annotated[float, quantity("1", -0.5, 0.5, "relative, of phase c")]
    back_emf: Annotated[int, _BACK_EMF[0], _BACK_EMF[1]]
    flat_top: Annotated[float, quantity("rad", 0.0, 3.0, "width of the trapezoid's top")]
    harmonic_3: Annotated[float, quantity("1", -0.5, 0.5, "of the fundamental")]
    harmonic_5: Annotated[float, quantity("1", -0.5, 0.5, "of the fundamental")]
    harmonic_7: Annotated[float, quantity("1", -0.5, 0.5, "of the fundamental")]
    pole_pairs: Annotated[int, _count(1, 50, "pole pairs")]
    torque_limit: Annotated[float, quantity("N m", 1e-3, 1e4, "saturation of the torque")]
    inertia: Annotated[float, quantity("kg m²", 1e-8, 10.0, "inertia of rotor and gear")]
    viscous_friction: Annotated[float, quantity("N m s/rad", 0.0, 10.0, "viscous")]
    dynamic_friction: Annotated[float, quantity("N m", 0.0, 1e3, "dry, while moving")]
    static_friction: Annotated[float, quantity("N m", 0.0, 1e3, "dry, at standstill")]


class Gear(NamedTuple):
    """Reduction gear."""

    ratio: Annotated[float, quantity("1", 1.0, 1e5, "motor rad a surface rad")]
    efficiency: Annotated[float, quantity("1", 0.05, 1.0, "of the torque, driving")]


class Surface(NamedTuple):
    """Control surface."""

    inertia: Annotated[float, quantity("kg m²", 1e-4, 1e4, "inertia")]
    viscous_friction: Annotated[float, quantity("N m s/rad", 0.0, 1e4, "viscous")]
    dynamic_friction: Annotated[float, quantity("N m", 0.0, 1e5, "dry, while moving")]
    static_friction: Annotated[float, quantity("N m", 0.0, 1e5, "dry, at standstill")]
    end_stop: Annotated[float, quantity("rad", 0.01, MAX_POSITION, "end stops at + and -")]


class Shaft(NamedTuple):
    """Elastic shaft with lost motion between gear and surface."""

    stiffness: Annotated[float, quantity("N m/rad", 1e2, 1e7, "stiffness")]
    damping: Annotated[float, quantity("N m s/rad", 0.0, 1e4, "damping")]
    backlash: Annotated[float, quantity("rad", 0.0, 0.1, "total lost motion, at the surface")]


class Control(NamedTuple):
    """Position (P) and speed (PI) control."""

    period: Annotated[float, quantity("s", 1e-5, 1e-3, "control period")]
    position_gain: Annotated[float, quantity("1/s", 0.0, 1e6, "speed a position error")]
    speed_limit: Annotated[float, quantity("rad/s", 0.1, 1e4, "of the motor")]
    proportional_gain: Annotated[float, quantity("A s/rad", 0.0, 1e3, "Kp")]
    integral_gain: Annotated[float, quantity("A/rad", 0.0, 1e5, "Ki")]


class Converters(NamedTuple):
    """Analogue to digital converters; position and speed close the loop."""

    position_range: Annotated[float, quantity("rad", 0.1, 100.0, "span")]
    position_bits: Annotated[int, _count(4, 32, "bits")]
    speed_range: Annotated[float, quantity("rad/s", 1.0, 1e5, "span")]
    speed_bits: Annotated[int, _count(4, 32, "bits")]
    current_range: Annotated[float, quantity("A", 0.1, 1e4, "span, of the record")]
    current_bits: Annotated[int, _count(4, 32, "bits")]
    angle_range: Annotated[float, quantity("rad", 6.0, 100.0, "span, of the record")]
    angle_bits: Annotated[int, _count(4, 32, "bits")]
    speed_offset: Annotated[
        float, quantity("steps", -1.0, 1.0, "of the speed's reading; -0.5: it truncates")] = 0.0


class Noise(NamedTuple):
    """White noise, rms a sample at `NOISE_RATE`."""

    speed: Annotated[float, quantity("rad/s", 0.0, 100.0, "inside the loop")]
    current: Annotated[float, quantity("A", 0.0, 10.0, "on the record only")]
    position: Annotated[float, quantity("rad", 0.0, 0.1, "inside the loop")]


class Acquisition(NamedTuple):
    """How the test is recorded. Time, motor speed and two phase currents are always there."""

    rate: Annotated[float, quantity("1/s", 1e3, 1e6, "samples a second")]
    view_rate: Annotated[float, quantity("1/s", 1.0, 1e6, "messages a second, for people")]
    sampling: Annotated[int, _SAMPLING[0], _SAMPLING[1]]
    time_at: Annotated[float, quantity("1", 0.0, 1.0, "place of its time in the interval")]
    command_latency: Annotated[float, quantity("1", 0.0, 100.0, "control periods until it acts")]
    reference_latency: Annotated[float, quantity("1", 0.0, 100.0, "control periods until it acts")]
    converters: Annotated[int, _yes("whether samples are rounded by converters")]
    phase_current_c: Annotated[int, _yes("whether the third current is recorded")]
    reference_currents: Annotated[int, _yes("whether the reference currents are recorded")]
    rotor_angle: Annotated[int, _yes("whether the rotor angle is recorded")]
    surface_position: Annotated[int, _yes("whether the surface position is recorded")]
    commutation_latency: Annotated[
        float, quantity("1", 0.0, 100.0, "control periods until the rotor's angle acts")] = 0.0

    @property
    def columns(self) -> tuple[int, ...]:
        """Columns of `channels.CHANNELS` that are recorded, in order."""
        absent: set[int] = set()
        for there, columns in (
            (self.phase_current_c, ALL[PHASE_CURRENTS][-1:]),
            (self.reference_currents, ALL[REFERENCE_CURRENTS]),
            (self.rotor_angle, (ROTOR_ANGLE,)), (self.surface_position, (SURFACE_POSITION,)),
        ):
            absent.update(() if there else columns)
        return tuple(column for column in ALL if column not in absent)


class Actuator(NamedTuple):
    """All parameters of one actuator."""

    drive: Drive
    inverter: Inverter
    motor: Motor
    gear: Gear
    surface: Surface
    shaft: Shaft
    control: Control
    converters: Converters
    noise: Noise
    acquisition: Acquisition

    @property
    def slew_speed(self) -> float:
        """Highest speed of the surface (rad/s)."""
        return self.control.speed_limit / self.gear.ratio

    @property
    def friction_torque(self) -> float:
        """Torque of the dry friction of motor and surface while they move, at the motor (N m)."""
        return self.motor.dynamic_friction + self.surface.dynamic_friction / self.gear.ratio

    @property
    def wind_up(self) -> float:
        """Travel of the motor until a surface at rest starts: lost motion, wind-up (rad)."""
        shaft = self.shaft
        return self.gear.ratio * (
            self.surface.static_friction / shaft.stiffness + shaft.backlash)

    def sample_noise(self, rate: float) -> Noise:
        """Return the noise of a sample of a record (rms); `noise` is that at `NOISE_RATE`.

        An instant of a current has all of its sensor's noise whatever the `rate`, a mean less
        the longer it is; speed and position are read once a period of the control.
        """
        instant, periods = self.acquisition.sampling == INSTANT, 1.0 / self.control.period
        inside = math.sqrt((periods if instant else min(rate, periods)) / NOISE_RATE)
        noise = self.noise
        return Noise(speed=noise.speed * inside, position=noise.position * inside,
                     current=noise.current * (1.0 if instant else math.sqrt(rate / NOISE_RATE)))

    def motor_angle(self, electrical: Any) -> Any:
        """Return the mechanical angle of the motor (rad) to electrical angles (rad), any shape.

        The rotor angle of a record is electrical; this is the one place that divides it.
        """
        return electrical / self.motor.pole_pairs


PARTS: dict[str, Any] = get_type_hints(Actuator)
"""The type of each section."""
FORMERLY = "formerly"
"""Section of a kit's file: hashes of earlier descriptions of the same type, see `kit`."""
OTHER_SECTIONS = ("tolerances", "conditions", "effects", FORMERLY)
"""Sections of the same file that describe no single actuator: see `spread` and `ema_sim`."""
_ADAPTERS = {name: TypeAdapter(part) for name, part in PARTS.items()}


def load_actuator(path: str | Path | None = None) -> Actuator:
    """Return the actuator that a model file describes, default that of the present kit.

    Sections are those of `Actuator`; what is left out keeps the value of the present kit. The
    effects that a model file may add are not looked at.

    Raises
    ------
    UsageError
        No such file, an unknown name, or a value out of bounds.
    """
    own = _of_kit(*kit_file(ACTUATOR))
    return own if path is None else actuator_from(sections_of(path), str(path), own)


@cache
def _of_kit(path: Path, _changed: int) -> Actuator:
    """Return the actuator of a kit's file: every parameter stands there, but for the defaults."""
    data = sections_of(path)
    _check_sections(data, str(path))
    missing = [f"{section}.{name}" for section, part in PARTS.items()
               for name in part._fields
               if name not in (data.get(section) or {}) and name not in part._field_defaults]
    if missing:
        raise UsageError(f"{path}: {missing[0]} is missing: every parameter stands there")
    return Actuator(**{name: _checked(name, data[name], str(path)) for name in PARTS})


def sections_of(path: str | Path) -> Mapping[str, Any]:
    """Return the sections of a model file, not looked into."""
    data = load_yaml(Path(path))
    if not isinstance(data, Mapping):
        raise UsageError(f"{path}: expected sections such as 'motor:', see {NOMINAL}")
    return data


def actuator_from(data: Mapping[str, Any], where: str, base: Actuator | None = None) -> Actuator:
    """Return `base`, default the present kit's actuator, with what the sections change."""
    actuator = load_actuator() if base is None else base
    for section, values in _check_sections(data, where).items():
        part = getattr(actuator, section)
        for name in values:
            if name not in part._fields:
                raise unknown_name(f"parameter of {section} in {where}", str(name), part._fields,
                                   f"see {NOMINAL}")
        checked = _checked(section, {**part._asdict(), **values}, where)
        actuator = actuator._replace(**{section: checked})
    return actuator


def _check_sections(data: Mapping[str, Any], where: str) -> dict[str, Mapping[str, Any]]:
    """Return the sections that describe an actuator; UsageError for one that nothing reads."""
    for section, values in data.items():
        if section not in PARTS and section not in OTHER_SECTIONS:
            raise unknown_name(f"section of {where}", str(section), [*PARTS, *OTHER_SECTIONS],
                               f"see {NOMINAL}")
        if section in PARTS and not isinstance(values, Mapping):
            raise UsageError(f"{where}: {section}: expected parameters and values")
    return {section: values for section, values in data.items() if section in PARTS}


def _checked(section: str, values: Mapping[str, Any], where: str) -> Any:
    """Return a section of those values; UsageError where one is out of its bounds."""
    return validated(_ADAPTERS[section].validate_python, dict(values), f"{where}: {section}",
                     section, f"see {NOMINAL}")
