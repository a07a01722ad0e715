"""The cascade at work: ANN_A says which, ANN_B how much, the guard whether to believe it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_prognostics.cascade_features import CascadeFeatures
from ema_prognostics.guard import LineGuard, MechanicsGuard
from ema_prognostics.line_inputs import (
    PHASES,
    LineStatistics,
    ann_a_inputs,
    eccentricity_inputs,
    guard_inputs,
    matched_short,
    short_inputs,
)
from ema_prognostics.network import Network

CLASSES = ("healthy", "turn_short", "rotor_eccentricity")
"""Outputs of ANN_A."""
WEAR = ("friction", "backlash")
LEVEL_CUTS = {"turn_short": (0.0775, 0.1695), "rotor_eccentricity": (0.0100, 0.0228)}
"""Severity at which small becomes medium, and medium large: the cuts at rows 6 and 14 of the
paper's 21 extents (`paper_cascade`)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeverityNetwork:
    """ANN_B of one fault, with the half width of its interval.

    Attributes
    ----------
    network : gives the log of the severity.
    at : ndarray, shape (m,). Severities at which the half width was measured.
    half_width : ndarray, shape (m,). 95 % of held-out runs lie within.
    """

    network: Network
    at: np.ndarray
    half_width: np.ndarray

    def estimate(self, inputs: np.ndarray) -> np.ndarray:
        """Return the severity, shape (n,)."""
        return np.exp(np.clip(self.network(inputs)[:, 0], -12.0, 0.0))

    def interval(self, severity: float) -> tuple[float, float]:
        """Return the 95 % interval around an estimate, not below 0."""
        half = float(np.interp(np.log(severity), np.log(self.at), self.half_width))
        return max(0.0, severity - half), severity + half


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessment:
    """What the cascade says of one record."""

    outputs: np.ndarray
    """Of ANN_A, shape (3,), in the order of `CLASSES`."""
    named: str
    """Class of the largest output."""
    phase: str | None
    severity: float | None
    interval: tuple[float, float] | None
    line_ratio: float
    band_ratio: float
    wear_ratio: float
    wear: str
    """The likelier wear, friction or backlash."""
    excess: np.ndarray
    """Mechanical features less those of sound units, in deviations, shape (d,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cascade:
    """All trained parts for one kind of test."""

    statistics: LineStatistics
    ann_a: Network
    ann_b: dict[str, SeverityNetwork]
    line_guards: dict[str, LineGuard]
    mechanics_guard: MechanicsGuard

    def severity_inputs(self, name: str, combined: np.ndarray) -> np.ndarray:
        """Return the inputs of ANN_B of that fault."""
        make = short_inputs if name == "turn_short" else eccentricity_inputs
        return make(combined, self.statistics)

    def assess(self, features: CascadeFeatures) -> Assessment:
        """Return what the cascade says of one record."""
        combined = self.statistics.combine(features.lines)[None]
        outputs = self.ann_a(ann_a_inputs(combined, self.statistics))[0]
        named = CLASSES[int(np.argmax(outputs))]
        severity, interval, phase = None, None, None
        short = np.zeros(1)
        if named in self.ann_b:
            ann_b = self.ann_b[named]
            severity = float(ann_b.estimate(self.severity_inputs(named, combined))[0])
            interval = ann_b.interval(severity)
        if named == "turn_short":
            phase = PHASES[int(matched_short(combined, self.statistics)[0][0])]
            short = np.array([severity])
        mechanics = features.mechanics[None]
        guard = self.mechanics_guard
        wear = guard.wear_outputs(mechanics, short)[0]
        return Assessment(
            outputs=outputs, named=named, phase=phase, severity=severity, interval=interval,
            line_ratio=float(
                self.line_guards[named].ratio(guard_inputs(combined, self.statistics))[0]
            ),
            band_ratio=float(guard.band_ratio(mechanics, short)[0]),
            wear_ratio=float(guard.wear_ratio(mechanics, short)[0]),
            wear=WEAR[int(np.argmax(wear[1:]))],
            excess=(guard.excess(mechanics, short) / guard.deviation)[0],
        )


def level_of(name: str, severity: float) -> str:
    """Return small, medium or large."""
    low, high = LEVEL_CUTS[name]
    return "small" if severity < low else ("medium" if severity < high else "large")
