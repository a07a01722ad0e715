"""`Evidence`: one number that speaks for a verdict, beside those of healthy units.

Every feature is compared with the healthy fleet of the training (centre and spread), and with a
baseline also with the unit's own healthy record; what is unlike anything known is compared with
the guard's usual bound. Values are in units that a person reads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import exp
from typing import Any, Literal, NamedTuple

import numpy as np

from ema_prognostics.cascade.find import Cascade, Detection
from ema_prognostics.features.vector import ABSOLUTE
from ema_prognostics.words import feature_words

RELEVANT = {
    "turn_short": ("_even_m2", "_even_m4", "resistance_spread", "inductance_spread"),
    "rotor_eccentricity": ("_even_m1", "_even_m3"),
    "friction": ("torque_", "gap_torque", "surface_torque"),
    "backlash": ("gap_width", "lag_", "start_stiffness"),
}
"""Features that speak for each class, by parts of their names."""
MOST = 3
LEAST = 2.0
"""Healthy spreads below which nothing speaks for a fault."""
COVERAGE = 1.645
"""Spreads to either side that hold 90 % of healthy units."""
DIGITS = 5
"""Significant digits of a number in the JSON object."""
GROUP, ALL = "group.", "all"
"""Beginning of the names of groups of features, and the name of all together."""
Measure = Literal["healthy", "bound"]


class Unit(NamedTuple):
    """How a feature is told to a person."""

    name: str
    law: Callable[[float], float]


UNITS: tuple[tuple[tuple[str, ...], Unit], ...] = (
    (("_over_", "viscous_"), Unit("", float)),
    (("_even_m", "_odd_m"), Unit("% of the mean torque", lambda v: 0.1 * v)),
    (("resistance_spread", "inductance_spread", "rise_spread"), Unit("%", lambda v: 100 * exp(v))),
    (("resistance_m1", "inductance_m1"), Unit("%", float)),
    (("torque_rms", "noise_current", "sum_rms"), Unit("A", exp)),
    (("torque_", "_torque"), Unit("N m", exp)),
    (("load_", "gap_load"), Unit("N m", float)),
    (("gap_width", "lag_ramp", "lag_quarter"), Unit("mrad", lambda v: 0.1 * v)),
    (("lag_", "position_over_angle"), Unit("mrad", float)),
    (("rise_time",), Unit("ms", float)),
    (("speed_full", "noise_speed", "speed_step", "speed_rms"), Unit("rad/s", exp)),
    (("sum_mean", "offset_largest"), Unit("A", float)),
    (("gain_largest",), Unit("%", lambda v: 100.0 * v)),
    (("temperature",), Unit("°C", lambda v: 50.0 * v + 20.0)),
    (("sensor_angle",), Unit("mrad", float)),
)
"""By parts of the features' names; others have the feature's own number, without a unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """One number that speaks for a verdict.

    Attributes
    ----------
    feature : its name.
    measure : what `times` counts: spreads of healthy units (signed), or the guard's usual bound.
    times : how far off it is.
    value, unit : as a person reads it; None: a distance of several features.
    healthy : range of 90 % of healthy units of the type.
    own : the same of this unit, by its baseline; None: without one.
    """

    feature: str
    measure: Measure
    times: float
    value: float | None = None
    unit: str = ""
    healthy: tuple[float, float] | None = None
    own: tuple[float, float] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values, with the feature in words."""
        return {
            "feature": self.feature, "words": feature_words(self.feature, "en"),
            "measure": self.measure, "times": _rounded(self.times),
            "value": None if self.value is None else _rounded(self.value), "unit": self.unit,
            "healthy": None if self.healthy is None else list(map(_rounded, self.healthy)),
            "own": None if self.own is None else list(map(_rounded, self.own)),
        }


def unit_of(feature: str) -> Unit:
    """Return how a feature is told to a person."""
    for parts, unit in UNITS:
        if any(part in feature for part in parts):
            return unit
    return Unit("", float)


class Measured(NamedTuple):
    """The features of a record, and what healthy units have."""

    cascade: Cascade
    """That judged."""
    x: np.ndarray
    """Its inputs, shape (d,); with a baseline the differences, then the features themselves."""
    fleet: Cascade
    """That of the type, without a baseline."""

    def evidence(self, place: int, z: np.ndarray) -> Evidence:
        """Return the evidence of the input at `place`; `z`: all in healthy spreads."""
        name = self.cascade.inputs.input_names[place]
        unit = unit_of(name)
        raw = self.cascade.inputs.raw(self.x[None])[0]
        value, own = float(raw[place]), None
        if self.cascade is not self.fleet:
            difference = value
            value = float(raw[self.cascade.inputs.input_names.index(f"{ABSOLUTE}{name}")])
            own = _range(unit, value - difference + float(self.cascade.inputs.center[place]),
                         float(self.cascade.inputs.spread[place]))
        return Evidence(
            feature=name, measure="healthy", times=float(z[place]), value=unit.law(value),
            unit=unit.name, own=own,
            healthy=healthy_range(self.fleet, name),
        )

    def strongest(self, classes: Iterable[str], least: float = LEAST) -> list[Evidence]:
        """Return what is off the most of that which speaks for `classes`, largest first.

        Of several features of the same words the first counts.
        """
        keys = [key for name in classes for key in RELEVANT[name]]
        names = self.cascade.inputs.input_names
        z = self.cascade.inputs.deviations(self.x[None])[0]
        chosen = [k for k, n in enumerate(names)
                  if any(key in n for key in keys) and not n.startswith(ABSOLUTE)]
        found: dict[str, Evidence] = {}
        for k in sorted(chosen, key=lambda k: -abs(z[k])):
            text = feature_words(names[k], "en")
            if abs(z[k]) >= least and text not in found:
                found[text] = self.evidence(k, z)
            if len(found) == MOST:
                break
        return list(found.values())


def healthy_range(cascade: Cascade, name: str) -> tuple[float, float]:
    """Return the range of 90 % of healthy units for a feature, in its unit for a person."""
    k = cascade.inputs.input_names.index(name)
    center, spread = float(cascade.inputs.center[k]), float(cascade.inputs.spread[k])
    return _range(unit_of(name), center, spread)


def guard_evidence(cascade: Cascade, detection: Detection) -> list[Evidence]:
    """Return what the guard finds unusual: features, groups of them, or all together."""
    guard = cascade.guard
    if guard is None:
        return []
    names = [
        *(cascade.inputs.input_names[k] for k in guard.checked),
        *(f"{GROUP}{name}" for name in guard.groups), ALL,
    ]
    singles = len(guard.checked)
    order = [*np.argsort(-detection.guard[:singles])[:MOST],
             *(singles + np.argsort(-detection.guard[singles:-1]))[:MOST]]
    found = [Evidence(feature=names[k], measure="bound", times=float(detection.guard[k]))
             for k in order if detection.guard[k] > 1.0][:MOST]
    return found or [Evidence(feature=ALL, measure="bound", times=float(detection.guard[-1]))]


def _range(unit: Unit, center: float, spread: float) -> tuple[float, float]:
    half = COVERAGE * spread
    low, high = sorted((unit.law(center - half), unit.law(center + half)))
    return low, high


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
