"""Classes and outputs of the robust cascade, their units and levels; how sure it is to know them.

The worst score of the guard has a tail probability p among known records. A stranger makes it
small; how small is not known, so the bound of Sellke, Bayarri and Berger (2001) stands for the
odds: a known record is at least −e p ln p times as likely as the best alternative.
"""

from __future__ import annotations

import numpy as np

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
KINDS_FOUND = ("healthy", "slight", "mechanical", "electrical", "both")
"""What may be found in a record: no fault, none that is clear, and where one is: friction or
backlash, a short or eccentricity, both."""
TAIL_RATES = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
STRANGERS = 0.04
"""Odds of a stranger before the record is seen."""
ELECTRICAL = 5
"""The first outputs, of `OUTPUTS`, are shorts and eccentricity."""
CLEAR = {"turn_short": 0.03, "rotor_eccentricity": 0.01, "friction": 0.2, "backlash": 3.0}
"""Severity, in `scale_of`, from which a fault is clear, and the guard's limits are wider:
it then moves features beside its own (the last two), or nothing but a fault looks like that (the
first two)."""


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


def kind_found(severity: np.ndarray) -> np.ndarray:
    """Return the place in `KINDS_FOUND`, shape (n,), of records with faults of `severity`.

    Parameters
    ----------
    severity : ndarray, shape (n, 8). Of each output; 0: it is not there.
    """
    electrical = (severity[:, :ELECTRICAL] > 0.0).any(axis=1)
    mechanical = (severity[:, ELECTRICAL:] > 0.0).any(axis=1)
    least = [scale_of(CLASS_OF[o]) * CLEAR[CLASS_OF[o]] for o in OUTPUTS]
    clear = (severity >= np.array(least)).any(axis=1)
    kinds = [
        ("both", clear & mechanical & electrical), ("mechanical", clear & mechanical),
        ("electrical", clear & electrical), ("slight", mechanical | electrical),
    ]
    return np.select([where for _, where in kinds],
                     [KINDS_FOUND.index(name) for name, _ in kinds],
                     default=KINDS_FOUND.index("healthy"))


def tail_probability(score: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """Return how often a known record scores more, shape (n,); beyond the table its trend.

    Parameters
    ----------
    score : ndarray, shape (n,). Worst score of each record.
    tail : ndarray, shape (8,). Scores exceeded at `TAIL_RATES`, growing.
    """
    log_rate = np.log(TAIL_RATES)
    found = np.interp(score, tail, log_rate)
    slope = (log_rate[-1] - log_rate[-3]) / max(float(tail[-1] - tail[-3]), 1e-3)
    beyond = score > tail[-1]
    found[beyond] = log_rate[-1] + slope * (score[beyond] - tail[-1])
    return np.exp(found)


def probability_known(p: np.ndarray) -> np.ndarray:
    """Return the probability that a record is of a known kind, shape (n,), from its tail p."""
    small = np.clip(p, 1e-12, np.exp(-1.0))
    return 1.0 / (1.0 + STRANGERS / (-np.e * small * np.log(small)))
