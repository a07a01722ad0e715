"""Symptoms: numbers that speak for a verdict, beside those of healthy units.

Every feature is compared with the healthy fleet of the training (centre and spread), and with a
baseline also with the unit's own healthy record; what is unlike anything known is compared with
the guard's usual bound. Values are in units that a person reads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import exp
from typing import NamedTuple

import numpy as np

from ema_prognostics.cascade.inputs import Inputs
from ema_prognostics.features.vector import ABSOLUTE, untold
from ema_prognostics.verdict.verdict import Symptom
from ema_prognostics.words import feature_words

RELEVANT = {
    "turn_short": ("_even_m2", "_even_m4", "resistance_spread", "inductance_spread"),
    "rotor_eccentricity": ("_even_m1", "_even_m3"),
    "friction": ("torque_", "gap_torque", "surface_torque"),
    "backlash": ("gap_width", "lag_", "start_stiffness", "start_gap"),
}
"""Features that speak for each class, by parts of their names."""
MOST = 3
LEAST = 2.0
"""Healthy spreads below which nothing speaks for a fault."""
COVERAGE = 1.645
"""Spreads to either side that hold 90 % of healthy units."""


class ReadUnit(NamedTuple):
    """How a feature is told to a person."""

    name: str
    law: Callable[[float], float]


UNITS: tuple[tuple[tuple[str, ...], ReadUnit], ...] = (
    (("viscous_torque",), ReadUnit("N m", float)),
    (("_over_", "viscous_"), ReadUnit("", float)),
    (("_even_m", "_odd_m"), ReadUnit("% of the mean torque", lambda v: 0.1 * v)),
    (("resistance_spread", "inductance_spread", "rise_spread"),
     ReadUnit("%", lambda v: 100 * exp(v))),
    (("resistance_m1", "inductance_m1"), ReadUnit("%", float)),
    (("torque_rms", "noise_current", "sum_rms"), ReadUnit("A", exp)),
    (("torque_", "_torque"), ReadUnit("N m", exp)),
    (("load_", "gap_load"), ReadUnit("N m", float)),
    (("gap_width", "lag_ramp", "lag_quarter"), ReadUnit("mrad", lambda v: 0.1 * v)),
    (("lag_", "start_gap"), ReadUnit("mrad", float)),
    (("rise_time",), ReadUnit("ms", float)),
    (("speed_full", "noise_speed", "speed_step", "speed_rms"), ReadUnit("rad/s", exp)),
    (("sum_mean", "offset_largest"), ReadUnit("A", float)),
    (("gain_largest",), ReadUnit("%", lambda v: 100.0 * v)),
    (("temperature",), ReadUnit("°C", lambda v: 50.0 * v + 20.0)),
    (("sensor_angle",), ReadUnit("mrad", float)),
)
"""By parts of the features' names; others have the feature's own number, without a unit."""


def unit_of(feature: str) -> ReadUnit:
    """Return how a feature is told to a person."""
    for parts, unit in UNITS:
        if any(part in feature for part in parts):
            return unit
    return ReadUnit("", float)


class Measured(NamedTuple):
    """The features of a record, and what healthy units have."""

    inputs: Inputs
    """Of the networks that judged."""
    x: np.ndarray
    """What they take, shape (d,); with a baseline the differences, then the features."""
    fleet: Inputs
    """Of those of the type, without a baseline."""

    @property
    def swings(self) -> bool:
        """Whether a slew swings, so that it does not count."""
        names = self.inputs.names
        return bool(untold(names, self.x[None], self.inputs.center[:len(names)]).any())

    def evidence(self, place: int, z: np.ndarray) -> Symptom:
        """Return the evidence of the input at `place`; `z`: all in healthy spreads."""
        name = self.inputs.input_names[place]
        unit = unit_of(name)
        raw = self.inputs.raw(self.x[None])[0]
        value, own = float(raw[place]), None
        if self.inputs is not self.fleet:
            difference = value
            value = float(raw[self.inputs.input_names.index(f"{ABSOLUTE}{name}")])
            own = _range(unit, value - difference + float(self.inputs.center[place]),
                         float(self.inputs.spread[place]))
        return Symptom(
            feature=name, measure="healthy", times=float(z[place]), value=unit.law(value),
            unit=unit.name, own=own,
            healthy=healthy_range(self.fleet, name),
        )

    def strongest(self, classes: Iterable[str], least: float = LEAST) -> list[Symptom]:
        """Return what is off the most of that which speaks for `classes`, largest first.

        Of several features of the same words the first counts.
        """
        keys = [key for name in classes for key in RELEVANT[name]]
        names = self.inputs.input_names
        z = self.inputs.deviations(self.x[None])[0]
        chosen = [k for k, n in enumerate(names)
                  if any(key in n for key in keys) and not n.startswith(ABSOLUTE)]
        found: dict[str, Symptom] = {}
        for k in sorted(chosen, key=lambda k: -abs(z[k])):
            text = feature_words(names[k], "en")
            if abs(z[k]) >= least and text not in found:
                found[text] = self.evidence(k, z)
            if len(found) == MOST:
                break
        return list(found.values())


def healthy_range(inputs: Inputs, name: str) -> tuple[float, float]:
    """Return the range of 90 % of healthy units for a feature, in its unit for a person."""
    k = inputs.input_names.index(name)
    center, spread = float(inputs.center[k]), float(inputs.spread[k])
    return _range(unit_of(name), center, spread)


def _range(unit: ReadUnit, center: float, spread: float) -> tuple[float, float]:
    half = COVERAGE * spread
    low, high = sorted((unit.law(center - half), unit.law(center + half)))
    return low, high
