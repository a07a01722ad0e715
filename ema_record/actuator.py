"""The description of an actuator: NamedTuples that enter the kernel, with units and bounds.

The bounds are those within which the model is meant to hold; `load_actuator` checks them. The
values of the default actuator stand in `config/actuator.yaml` and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_type_hints

from pydantic import Field, TypeAdapter, ValidationError

from ema_record.errors import UsageError, first_problem, unknown_name
from ema_record.limits import MAX_POSITION
from ema_record.resources import share_path
from ema_record.yaml_file import load_yaml

NOMINAL = "config/actuator.yaml"
NOISE_RATE = 20_000.0
"""Rate that the values of `Noise` are given for (1/s): white noise is less on a longer mean."""


def _unit(unit: str, lower: float, upper: float, text: str) -> object:
    """Return the pydantic field of a quantity: bounds, unit, meaning."""
    return Field(
        ge=lower, le=upper, allow_inf_nan=False, description=text, json_schema_extra={"unit": unit}
    )


def _count(lower: int, upper: int, text: str) -> object:
    return Field(ge=lower, le=upper, description=text, json_schema_extra={"unit": "1"})


class Inverter(NamedTuple):
    """Three half bridges with a hysteresis current control a phase."""

    bus_voltage: Annotated[float, _unit("V", 1.0, 400.0, "leg voltage, + and -")]
    hysteresis: Annotated[float, _unit("A", 0.05, 10.0, "half width of the band")]
    current_limit: Annotated[float, _unit("A", 0.1, 500.0, "limit of the reference")]


class Motor(NamedTuple):
    """Brushless DC motor: three phases in star, trapezoidal back-EMF."""

    phase_resistance: Annotated[float, _unit("Ω", 1e-3, 100.0, "R of a phase")]
    phase_inductance: Annotated[float, _unit("H", 2e-5, 0.1, "L of a phase")]
    back_emf_constant: Annotated[float, _unit("V s/rad", 1e-4, 10.0, "k of a phase")]
    back_emf_deviation_a: Annotated[float, _unit("1", -0.5, 0.5, "relative, of phase a")]
    back_emf_deviation_b: Annotated[float, _unit("1", -0.5, 0.5, "relative, of phase b")]
    back_emf_deviation_c: Annotated[float, _unit("1", -0.5, 0.5, "relative, of phase c")]
    flat_top: Annotated[float, _unit("rad", 0.0, 3.0, "width of the trapezoid's top")]
    pole_pairs: Annotated[int, _count(1, 50, "pole pairs")]
    torque_limit: Annotated[float, _unit("N m", 1e-3, 1e4, "saturation of the torque")]
    inertia: Annotated[float, _unit("kg m²", 1e-8, 10.0, "inertia of rotor and gear")]
    viscous_friction: Annotated[float, _unit("N m s/rad", 0.0, 10.0, "viscous")]
    dynamic_friction: Annotated[float, _unit("N m", 0.0, 1e3, "dry, while moving")]
    static_friction: Annotated[float, _unit("N m", 0.0, 1e3, "dry, at standstill")]


class Gear(NamedTuple):
    """Reduction gear."""

    ratio: Annotated[float, _unit("1", 1.0, 1e5, "motor rad a surface rad")]
    efficiency: Annotated[float, _unit("1", 0.05, 1.0, "of the torque, driving")]


class Surface(NamedTuple):
    """Control surface."""

    inertia: Annotated[float, _unit("kg m²", 1e-4, 1e4, "inertia")]
    viscous_friction: Annotated[float, _unit("N m s/rad", 0.0, 1e4, "viscous")]
    dynamic_friction: Annotated[float, _unit("N m", 0.0, 1e5, "dry, while moving")]
    static_friction: Annotated[float, _unit("N m", 0.0, 1e5, "dry, at standstill")]
    end_stop: Annotated[float, _unit("rad", 0.01, MAX_POSITION, "end stops at + and -")]


class Shaft(NamedTuple):
    """Elastic shaft with lost motion between gear and surface."""

    stiffness: Annotated[float, _unit("N m/rad", 1e2, 1e7, "stiffness")]
    damping: Annotated[float, _unit("N m s/rad", 0.0, 1e4, "damping")]
    backlash: Annotated[float, _unit("rad", 0.0, 0.1, "total lost motion, at the surface")]


class Control(NamedTuple):
    """Position (P) and speed (PI) control."""

    period: Annotated[float, _unit("s", 1e-5, 1e-3, "control period")]
    position_gain: Annotated[float, _unit("1/s", 0.0, 1e6, "speed a position error")]
    speed_limit: Annotated[float, _unit("rad/s", 0.1, 1e4, "of the motor")]
    proportional_gain: Annotated[float, _unit("A s/rad", 0.0, 1e3, "Kp")]
    integral_gain: Annotated[float, _unit("A/rad", 0.0, 1e5, "Ki")]


class Converters(NamedTuple):
    """Analogue to digital converters; position and speed close the loop."""

    position_range: Annotated[float, _unit("rad", 0.1, 100.0, "span")]
    position_bits: Annotated[int, _count(4, 32, "bits")]
    speed_range: Annotated[float, _unit("rad/s", 1.0, 1e5, "span")]
    speed_bits: Annotated[int, _count(4, 32, "bits")]
    current_range: Annotated[float, _unit("A", 0.1, 1e4, "span, of the record")]
    current_bits: Annotated[int, _count(4, 32, "bits")]
    angle_range: Annotated[float, _unit("rad", 6.0, 100.0, "span, of the record")]
    angle_bits: Annotated[int, _count(4, 32, "bits")]


class Noise(NamedTuple):
    """White noise, rms a sample at `NOISE_RATE`."""

    speed: Annotated[float, _unit("rad/s", 0.0, 100.0, "inside the loop")]
    current: Annotated[float, _unit("A", 0.0, 10.0, "on the record only")]
    position: Annotated[float, _unit("rad", 0.0, 0.1, "inside the loop")]


class Acquisition(NamedTuple):
    """How the test is recorded."""

    rate: Annotated[float, _unit("1/s", 1e3, 1e6, "samples a second")]
    view_rate: Annotated[float, _unit("1/s", 1.0, 1e6, "messages a second of a view for people")]


class Actuator(NamedTuple):
    """All parameters of one actuator."""

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

    def motor_angle(self, electrical: Any) -> Any:
        """Return the mechanical angle of the motor (rad) to electrical angles (rad), any shape.

        The rotor angle of a record is electrical; this is the one place that divides it.
        """
        return electrical / self.motor.pole_pairs


PARTS: dict[str, Any] = get_type_hints(Actuator)
"""The type of each section."""
_ADAPTERS = {name: TypeAdapter(part) for name, part in PARTS.items()}


def load_actuator(path: str | Path | None = None) -> Actuator:
    """Return the actuator that a model file describes, default the nominal one.

    Sections are those of `Actuator`; what is left out keeps the nominal value. The effects
    that a model file may add are not looked at.

    Raises
    ------
    UsageError
        No such file, an unknown name, or a value out of bounds.

    """
    if path is None:
        return _nominal()
    return actuator_from(sections_of(path), str(path))


@cache
def _nominal() -> Actuator:
    data = sections_of(share_path(NOMINAL), NOMINAL)
    missing = [f"{section}.{name}" for section, part in PARTS.items()
               for name in part._fields if name not in (data.get(section) or {})]
    if missing:
        raise UsageError(f"{NOMINAL}: {missing[0]} is missing: every parameter stands there")
    parts = {name: part(**{field: data[name][field] for field in part._fields})
             for name, part in PARTS.items()}
    return actuator_from(data, NOMINAL, Actuator(**parts))


def sections_of(path: str | Path, where: str = "") -> Mapping[str, Any]:
    """Return the sections of a model file, not looked into; `where` names it in errors."""
    data = load_yaml(Path(path))
    if not isinstance(data, Mapping):
        raise UsageError(f"{where or path}: expected sections such as 'motor:', see {NOMINAL}")
    return data


def actuator_from(data: Mapping[str, Any], where: str, base: Actuator | None = None) -> Actuator:
    """Return `base`, default the nominal actuator, with what the sections change."""
    actuator = _nominal() if base is None else base
    for section, values in data.items():
        if section == "effects":
            continue
        if section not in PARTS:
            raise unknown_name(f"section of {where}", str(section), [*PARTS, "effects"],
                               f"see {NOMINAL}")
        if not isinstance(values, Mapping):
            raise UsageError(f"{where}: {section}: expected parameters and values")
        part = getattr(actuator, section)
        for name in values:
            if name not in part._fields:
                raise unknown_name(f"parameter of {section} in {where}", str(name), part._fields,
                                   f"see {NOMINAL}")
        try:
            checked = _ADAPTERS[section].validate_python({**part._asdict(), **values})
        except ValidationError as error:
            text = first_problem(error, f"{where}: {section}", section, f"see {NOMINAL}")
            raise UsageError(text) from None
        actuator = actuator._replace(**{section: checked})
    return actuator
