"""Severities of units whose fault grows by a known law, seen with the errors of the verdicts.

A course runs from the severity that a flight detects to the class's level *large*, over 20 to
120 flights, and on until it has passed. No actuator is simulated: the errors were measured
once, see `ERRORS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.detection.flight_scores import CLASS_OF
from benchmarks.detection.flights import TARGETS
from benchmarks.detection.sequences import growth_path
from ema_prognostics.cascade.classes import levels_of
from ema_prognostics.trend.announcement import FOUND, History
from ema_prognostics.trend.growth import QUANTILE

VERSION = 1
"""Of what is drawn."""
FLIGHTS = (20, 120)
"""From the first flight that finds the fault to the one that passes, evenly in the logarithm."""


class Errors(NamedTuple):
    """Errors of the severities of one kind of fault.

    The verdict states the deviation hypot(floor, part s). Of it, the three others are the parts
    that all flights of a unit share, that wanders slowly, and that is new in each flight.
    """

    floor: float
    part: float
    shared: float
    slow: float
    white: float


ERRORS = {
    ("turn_short", "baseline"): Errors(8.1e-4, 0.018, 0.47, 0.17, 0.53),
    ("turn_short", "fleet"): Errors(2.8e-3, 0.043, 0.83, 0.0, 0.47),
    ("rotor_eccentricity", "baseline"): Errors(4.7e-4, 0.072, 0.55, 0.06, 0.54),
    ("rotor_eccentricity", "fleet"): Errors(6.3e-4, 0.081, 0.47, 0.25, 0.60),
    ("motor_friction", "baseline"): Errors(4.0e-3, 0.071, 0.76, 0.36, 0.31),
    ("motor_friction", "fleet"): Errors(6.6e-2, 0.137, 0.49, 0.21, 0.27),
    ("surface_friction", "baseline"): Errors(4.5e-3, 0.069, 0.64, 0.50, 0.28),
    ("surface_friction", "fleet"): Errors(4.5e-2, 0.281, 0.49, 0.33, 0.21),
    ("backlash", "baseline"): Errors(3.1e-6, 0.027, 0.36, 0.29, 0.35),
    ("backlash", "fleet"): Errors(1.5e-5, 0.044, 0.63, 0.31, 0.39),
}
"""Measured on every second faulty flight of 15 units of `benchmarks.detection.sequences` (1 to 5,
7 to 11, 13, 15, 17, 19, 20; 497 verdicts), with wandering temperature, bus, load, noise, sensors
and start angle. Two to four units a kind: the shared part is known to half its size."""
SLOW = 0.9
"""Correlation of the slow part from flight to flight."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """One fault of one unit.

    Attributes
    ----------
    kind : of the fault.
    level : severity to reach.
    first : index of the first flight that the forecast is asked about; after a repair, of the
        first one since.
    passed : index of the first flight at or above `level`.
    severity : ndarray, shape (n,). The truth.
    seen, deviation : ndarray, shape (n,). What the verdicts say, with the deviation they state.
    """

    kind: str
    level: float
    first: int
    passed: int
    severity: np.ndarray
    seen: np.ndarray
    deviation: np.ndarray

    def history(self, flights: int) -> History:
        """Return the first `flights` flights as the trend sees them."""
        y, half = self.seen[:flights], QUANTILE * self.deviation[:flights]
        return History(
            fault_class=CLASS_OF.get(self.kind, self.kind), phase=None, unit="1",
            number=np.arange(1, flights + 1), state=np.full(flights, FOUND),
            severity=y, lower=np.maximum(0.0, y - half), upper=y + half,
        )


def _steady(_rng: np.random.Generator, u: np.ndarray, _ratio: float) -> np.ndarray:
    return u


def _exponential(_rng: np.random.Generator, u: np.ndarray, ratio: float) -> np.ndarray:
    return (ratio**u - 1.0) / (ratio - 1.0)


def _power(rng: np.random.Generator, u: np.ndarray, _ratio: float) -> np.ndarray:
    return u ** rng.uniform(1.5, 3.0)


def _stall(rng: np.random.Generator, u: np.ndarray, _ratio: float) -> np.ndarray:
    """Return steady growth that stands still for a quarter to half of the time."""
    length = rng.uniform(0.25, 0.5)
    begin = rng.uniform(0.2, 0.8) * (1.0 - length)
    return np.where(u < begin, u, np.maximum(begin, u - length)) / (1.0 - length)


def _irregular(rng: np.random.Generator, u: np.ndarray, _ratio: float) -> np.ndarray:
    """Return plateaus, slow growth and bursts, as in the detection benchmark."""
    path = growth_path(rng, 2 * len(u))
    path = np.concatenate([[0.0], path[np.argmax(path > 0.0):]])[:len(u)]
    return path / path[np.argmax(u >= 1.0)]


LAWS: dict[str, Callable[[np.random.Generator, np.ndarray, float], np.ndarray]] = {
    "linear": _steady, "exponential": _exponential, "power law": _power,
    "stalled": _stall, "irregular": _irregular, "repaired": _steady,
}
"""Growth from 0 to 1 over times `u` from 0 to 1 and on, given the generator and the ratio of the
severities at its ends."""


def draw_course(law: str, number: int, seed: int) -> Course:
    """Return a course; all follows from law, number and seed."""
    rng = np.random.default_rng([seed, VERSION, list(LAWS).index(law), number])
    kind, view = list(ERRORS)[number % len(ERRORS)]
    start, level = TARGETS[view][kind], levels_of(CLASS_OF.get(kind, kind))[1]
    life = round(float(np.exp(rng.uniform(*np.log(FLIGHTS)))))
    u = np.arange(round(1.5 * life) + 1) / life
    severity = start + (level - start) * LAWS[law](rng, u, level / start)
    first = 0
    if law == "repaired":
        before = int(rng.integers(life // 3, 1 + 2 * life // 3))
        first = before
        worn = start + (level - start) * u[:before] * rng.uniform(0.9, 1.4)
        severity = np.concatenate([worn, severity])
    passed = first + int(np.argmax(severity[first:] >= level * (1.0 - 1e-9)))
    return _seen(rng, kind, view, level, first, passed, severity)


def _seen(
    rng: np.random.Generator, kind: str, view: str, level: float, first: int, passed: int,
    severity: np.ndarray,
) -> Course:
    errors = ERRORS[kind, view]
    deviation = np.hypot(errors.floor, errors.part * severity)
    slow, z = np.zeros(len(severity)), rng.standard_normal()
    for k in range(len(slow)):
        slow[k] = z
        z = SLOW * z + np.sqrt(1.0 - SLOW**2) * rng.standard_normal()
    error = (errors.shared * rng.standard_normal() + errors.slow * slow
             + errors.white * rng.standard_normal(len(severity)))
    return Course(
        kind=kind, level=level, first=first, passed=passed, severity=severity,
        seen=np.maximum(0.0, severity + deviation * error),
        deviation=deviation,
    )
