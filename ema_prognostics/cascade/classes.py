"""Classes and outputs of the robust cascade, their units and levels."""

from __future__ import annotations

from ema_record.actuator import load_actuator

FAULTS = ("turn_short", "rotor_eccentricity", "friction", "backlash")
"""Classes that a verdict names."""
OUTPUTS = ("short_a", "short_b", "short_c", "eccentricity", "static_eccentricity",
           "motor_friction", "surface_friction", "backlash")
"""What the first network tells apart."""
SHORTS = OUTPUTS[:3]
CLASS_OF = dict(zip(OUTPUTS, ("turn_short",) * 3 + ("rotor_eccentricity",) * 2
                    + ("friction",) * 2 + ("backlash",)))
FAMILIES: dict[str, tuple[str, ...]] = {
    "asymmetry": (*SHORTS, "static_eccentricity"), "eccentricity": ("eccentricity",),
    "motor_friction": ("motor_friction",), "surface_friction": ("surface_friction",),
    "backlash": ("backlash",),
}
"""What is found first: outputs that move the same features, named apart only afterwards."""
FAMILY_OF = {output: name for name, outputs in FAMILIES.items() for output in outputs}
SEVERITY_OF = dict(zip(OUTPUTS, ("short",) * 3 + OUTPUTS[3:]))
"""Network of the severity of each output; the phases share one."""
UNITS = {"turn_short": "1", "rotor_eccentricity": "1", "friction": "1", "backlash": "rad"}
"""Units of the severities: parts of the turns, of the air gap, of the friction; rad."""
LEVELS = {"turn_short": (0.0775, 0.1695), "rotor_eccentricity": (0.0100, 0.0228),
          "friction": (0.2, 0.5), "backlash": (3.0, 10.0)}
"""Bounds between small, medium and large, in `scale_of` the class; those of the paper for its two
faults, in parts."""
LOST_MOTION = 0.1
"""Unit of lost motion, of what the surface lags when it starts (lost motion and wind-up)."""


def scale_of(fault_class: str) -> float:
    """Return what severities of a class are counted in, in its unit of `UNITS`.

    That is 1, or for lost motion a part of that of the kit's actuator (rad at the surface).
    """
    if UNITS[fault_class] != "rad":
        return 1.0
    actuator = load_actuator()
    return LOST_MOTION * actuator.wind_up / actuator.gear.ratio


def levels_of(fault_class: str) -> tuple[float, float]:
    """Return the severities between small, medium and large, in the unit of the class."""
    low, high = LEVELS[fault_class]
    return scale_of(fault_class) * low, scale_of(fault_class) * high


def level_of(fault_class: str, severity: float) -> str:
    """Return small, medium or large."""
    low, high = levels_of(fault_class)
    return "small" if severity < low else "medium" if severity < high else "large"
