"""The words of a verdict: names of faults, severities in units that people read, features."""

from __future__ import annotations

from collections.abc import Sequence

NAMES = {
    "turn_short": "turn short", "rotor_eccentricity": "rotor eccentricity",
    "friction": "friction", "backlash": "backlash",
}
"""Of the classes."""
SCALES = {
    "turn_short": (100.0, "% of the turns"), "rotor_eccentricity": (100.0, "% of the air gap"),
    "friction": (100.0, "% increase"), "backlash": (1e3, "mrad"),
}
"""Factor from the SI value of a severity to the unit that a person reads, and that unit."""
LOOK_ALIKES = {
    "turn_short": {"rotor_eccentricity": "static rotor eccentricity (its probability is in that "
                                         "of the turn short)"},
    "rotor_eccentricity": {"turn_short": "turn short of two phases (its probability is in that "
                                         "of the rotor eccentricity)"},
}
"""The alternatives of a fault that is named, by its class, then by theirs."""
FEATURES = {
    "torque_full": "torque needed at full speed",
    "torque_quarter": "torque needed at a quarter of the speed",
    "torque_ramp": "torque needed on the slow ramp",
    "gap_torque": "torque of the motor alone, with the gear free",
    "gap_width": "lost motion where the ramp turns round",
    "lag_ramp": "lag of the surface behind the motor on the ramps",
    "lag_quarter": "lag of the surface behind the motor at a quarter of the speed",
    "shaft_slope": "stiffness of the shaft", "rise_time": "time to full speed",
    "overshoot": "overshoot of the speed", "speed_full": "full speed",
    "start_position": "position before the test", "sum_mean": "sum of the phase currents",
    "sum_rms": "scatter of the sum of the phase currents",
    "gain_largest": "difference between the current sensors",
    "offset_largest": "offset of a current sensor",
    "noise_speed": "noise of the speed sensor", "noise_current": "noise of a current sensor",
    "noise_current_least": "noise of the quietest current sensor",
    "reference_rms": "current against its reference",
    "reference_spread": "current against its reference, phase by phase",
    "reference_sum": "sum of the reference currents",
    "torque_full_over_quarter": "growth of the torque with speed",
    "lag_at_rest": "wind-up between rest and slew",
    "lag_peak": "peak of the wind-up at the start",
    "start_stiffness_1": "stiffness behind the motor when it starts",
    "start_stiffness_2": "stiffness behind the motor after its first 0.25 rad",
    "surface_torque": "torque that the surface takes",
    "compliance": "wind-up of the shaft by its torque",
    "stiffness_agreement": "stiffness of the shaft, from the ramps against the reversals",
    "viscous_torque": "torque that grows with the speed",
    "torque_quarter_over_ramp": "growth of the torque from ramp to slew",
    "dry_torque": "dry friction of motor and surface together",
    "viscous_share": "viscous friction, as grease makes it",
    "position_step": "resolution of the position", "speed_step": "resolution of the speed",
    "winding_inductance": "inductance of the winding",
    "winding_resistance": "resistance of the winding, its temperature allowed for",
    "winding_back_emf": "back-EMF, voltage a speed",
    "switch_drop": "voltage lost in the inverter's switches",
    "sensor_angle": "angle of the commutation sensor against the back-EMF",
    "resistance_spread": "difference between the resistances of the phases",
    "inductance_spread": "difference between the inductances of the phases",
    "resistance_m1_re": "difference between the resistances of the phases",
    "resistance_m1_im": "difference between the resistances of the phases",
    "inductance_m1_re": "difference between the inductances of the phases",
    "inductance_m1_im": "difference between the inductances of the phases",
    "winding_unlike": "difference between the windings that no short makes",
    "winding_error": "what the voltages leave unexplained",
    "control_delay": "delay of the controller", "control_gain": "gain of the controller",
    "inertia": "inertia of the motor",
    "inertia_error": "torque unexplained while the motor accelerates",
    "bus_sag": "fall of the bus voltage with its current",
    "shaft_bend": "friction that grows with the load of the gear",
    **{f"lag_start_{k}": "wind-up of the shaft when the motor starts" for k in range(1, 10)},
}
"""What a feature is."""
REPEAT = ("repeat the test; if it says the same again, 'ema identify RECORD' tells what has "
          "changed, and --baseline compares with the unit's own healthy record")
NEXT_STEPS: tuple[tuple[tuple[str, ...], str], ...] = (
    (("noise_", "sum_", "reference_", "offset_", "gain_", "position_step", "speed_step",
      "speed_over_angle", "position_over_angle", "position_rms", "start_position"),
     "look at that sensor and its cable ('ema lint RECORD' tells more), then repeat the test"),
    (("control_", "bus_sag", "switch_drop", "sensor_angle", "overshoot"),
     "compare supply and settings of the drive with the type's actuator.yaml, then repeat the "
     "test; 'ema identify RECORD' tells what differs"),
)
"""What to do about a record that is unlike anything known, by the beginnings of the features."""


def class_name(fault_class: str, phase: str | None = None) -> str:
    """Return a fault in words: ``turn short, phase b``."""
    return NAMES.get(fault_class, fault_class) + (f", phase {phase}" if phase else "")


def scaled(fault_class: str, unit: str | None = None) -> tuple[float, str]:
    """Return factor and unit of a severity; `unit` is that of a class not known here."""
    return SCALES.get(fault_class, (1.0, unit or ""))


def size(fault_class: str, value: float | None) -> str:
    """Return a severity in the unit that people read, or a dash."""
    factor, unit = scaled(fault_class)
    return "-" if value is None else f"{factor * value:.3g} {unit}"


def severity_words(
    fault_class: str, severity: float | None, interval: Sequence[float] | None = None
) -> str:
    """Return a severity with its interval, short: ``9.92 % (9.28 to 10.6)``."""
    if severity is None:
        return ""
    scale, unit = scaled(fault_class)
    text = f"{scale * severity:.3g} {unit.partition(' ')[0]}".rstrip()
    if interval:
        text += f" ({scale * interval[0]:.3g} to {scale * interval[1]:.3g})"
    return text


def counted(flights: int) -> str:
    """Return a number of flights in words."""
    return f"{flights} flight{'' if flights == 1 else 's'}"


def look_alike(named: Sequence[str], alternative: str) -> str:
    """Return an alternative in words, beside the classes that are named."""
    found = (LOOK_ALIKES.get(name, {}).get(alternative) for name in named)
    return next(filter(None, found), NAMES.get(alternative, alternative))


def next_step(feature: str) -> str:
    """Return what to do where a feature is unlike anything known."""
    found = (text for names, text in NEXT_STEPS if feature.startswith(names))
    return next(found, REPEAT)


def feature_words(name: str) -> str:
    """Return what the feature `name` is, in words."""
    if name in FEATURES:
        return FEATURES[name]
    for speed in ("full", "quarter"):
        at = "at full speed" if speed == "full" else "at a quarter of the speed"
        if name.startswith(f"{speed}_") and "_m" in name:
            h = name[name.rindex("_m") + 2:].partition("_")[0]
            kind = "torque ripple" if "_even_" in name else "ripple of the speed sensor"
            return f"{kind} {h} times a turn, {at}"
        if name.endswith((f"_{speed}", f"_{speed}_back")):
            stem = name.removesuffix("_back").removesuffix(f"_{speed}")
            known = {
                "rise": "time in which a phase takes over the current",
                "rise_spread": "difference between the phases in taking over the current",
                "load": "difference of the torque forward and back",
                "high_low": "fine torque ripple (7 to 12 a turn)",
                "high_mid": "fine torque ripple (13 to 20 a turn)",
                "high_top": "fine torque ripple (21 to 36 a turn)",
                "speed_over_angle": "speed sensor against rotor angle",
                "position_over_angle": "surface position against rotor angle",
                "position_rms": "scatter of the position", "speed_rms": "scatter of the speed",
                "torque_rms": "scatter of the torque current",
            }
            if stem in known:
                return f"{known[stem]}, {at}"
    return name.replace("_", " ")
