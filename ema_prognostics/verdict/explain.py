"""The reasons of a verdict in words that a technician understands."""

from __future__ import annotations

import numpy as np

from ema_prognostics.cascade.classes import CLASS_OF
from ema_prognostics.cascade.find import Cascade, Finding
from ema_prognostics.cascade.guard_groups import GROUPS

WORDS = {
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
"""What a feature is, for a person."""
RELEVANT = {
    "turn_short": ("_even_m2", "_even_m4", "resistance_spread", "inductance_spread"),
    "rotor_eccentricity": ("_even_m1", "_even_m3"),
    "friction": ("torque_", "gap_torque", "surface_torque"),
    "backlash": ("gap_width", "lag_", "start_stiffness"),
}
"""Features that speak for each class."""
MOST = 3


def words(name: str) -> str:
    """Return what the feature `name` is, in words."""
    if name in WORDS:
        return WORDS[name]
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


def reasons_of_fault(cascade: Cascade, x: np.ndarray, output: str) -> list[str]:
    """Return what moved, largest first, for an announced output; `x` has shape (d,)."""
    keys = RELEVANT[CLASS_OF[output]]
    names = cascade.inputs.input_names
    z = cascade.inputs.deviations(x[None])[0]
    chosen = [k for k, n in enumerate(names)
              if any(key in n for key in keys) and not n.startswith("absolute_")]
    chosen.sort(key=lambda k: -abs(z[k]))
    found: list[str] = []
    for k in chosen:
        text = words(names[k])
        if abs(z[k]) >= 2.0 and not any(f.startswith(text) for f in found):
            found.append(f"{text}: {z[k]:+.1f} healthy deviations")
        if len(found) == MOST:
            break
    return found


def reasons_of_guard(cascade: Cascade, finding: Finding, bound: float = 1.0) -> list[str]:
    """Return what is unlike anything trained on, worst first; empty where nothing is.

    Parameters
    ----------
    cascade : that found it.
    finding : what it found.
    bound : of the guard's scores, above 1 where another guard judges too.
    """
    guard = cascade.guard
    if guard is None or finding.guard.max() <= bound:
        return []
    names = cascade.inputs.input_names
    m = len(guard.checked)
    each, groups, together = finding.guard[:m], finding.guard[m:-1], float(finding.guard[-1])
    found = [
        f"{words(names[guard.checked[k]])}: {each[k]:.1f} times the usual bound"
        for k in np.argsort(-each)[:MOST] if each[k] > 1.0
    ]
    found += [
        f"{GROUPS[guard.groups[k]].words}, together: {groups[k]:.1f} times the usual distance"
        for k in np.argsort(-groups)[:MOST - len(found)] if groups[k] > 1.0
    ]
    if not found:
        worst = words(names[guard.checked[int(np.argmax(each))]])
        found.append(f"all features together: {together:.1f} times the usual distance, most of "
                     f"all the {worst}")
    return found
