"""Verdicts on the held-out fleet, as arrays that the tables are made of."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.detection.fleet import Case
from benchmarks.detection.generate import Tested
from ema_prognostics.cascade.model_file import TrainedModel
from ema_prognostics.verdict.diagnose import verdict_of_features
from ema_prognostics.verdict.report import unknown_verdict
from ema_prognostics.verdict.verdict import Fault, Verdict

View = Literal["fleet", "baseline"]
VIEWS: tuple[View, ...] = ("fleet", "baseline")
CLASS = {
    "turn_short": "turn_short", "rotor_eccentricity": "rotor_eccentricity",
    "static_eccentricity": "rotor_eccentricity", "motor_friction": "friction",
    "surface_friction": "friction", "backlash": "backlash",
}
"""Class of each group of faults."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """One held-out record with its verdict."""

    case: Case
    verdict: Verdict

    @property
    def outcome(self) -> str:
        """Healthy, unknown, invalid, incomplete, or the classes joined by ``+``."""
        if self.verdict.outcome != "fault":
            return self.verdict.outcome
        return "+".join(sorted(f.fault_class for f in self.verdict.faults))

    @property
    def detected(self) -> bool:
        """Whether a fault is announced."""
        return self.verdict.outcome == "fault"

    @property
    def truth(self) -> set[str]:
        """Classes that are there."""
        return {CLASS[name] for name in self.case.truth}

    @property
    def right(self) -> bool:
        """Whether the classes are named; a pair that physics cannot separate may be named."""
        named = {f.fault_class for f in self.verdict.faults}
        return self.truth <= named | set(self.verdict.alternatives) and bool(named)

    @property
    def severity(self) -> float:
        """Severity of the one fault that is there."""
        return next(iter(self.case.truth.values()))

    @property
    def fault(self) -> Fault | None:
        """What the verdict says of the one class that is there."""
        return next((f for f in self.verdict.faults if f.fault_class in self.truth), None)

    @property
    def confidence(self) -> float:
        """Probability that the verdict gives to what it says."""
        p = self.verdict.probabilities
        if self.verdict.outcome == "fault":
            return float(max(p.get(f.fault_class, 0.0) for f in self.verdict.faults))
        return float(p.get(self.verdict.outcome, 1.0))


def judge(fleet: Iterable[Tested], model: TrainedModel, view: View) -> list[Judged]:
    """Return the verdicts of a view on all records; without a baseline's features: none."""
    found = []
    for case, base, later, checks in fleet:
        if view == "baseline" and base is None:
            continue
        if checks:
            verdict = Verdict(outcome=checks)  # type: ignore[arg-type]
        elif later is None:
            verdict = unknown_verdict("no features")
        else:
            verdict = verdict_of_features(
                later, "extended", model, base if view == "baseline" else None)
        found.append(Judged(case=case, verdict=verdict))
    return found


def of(judged: Sequence[Judged], *groups: str) -> list[Judged]:
    """Return those of the groups."""
    return [j for j in judged if j.case.group in groups]


def severities(judged: Sequence[Judged]) -> np.ndarray:
    """Return the severities, shape (n,)."""
    return np.array([j.severity for j in judged])


def detected(judged: Sequence[Judged]) -> np.ndarray:
    """Return whether a fault is announced, shape (n,)."""
    return np.array([j.detected for j in judged], dtype=bool)


def inside(judged: Sequence[Judged]) -> list[bool]:
    """Return whether the interval holds the truth, of those whose class is named."""
    found = []
    for j in judged:
        fault = j.fault
        if fault is not None and fault.severity_interval is not None:
            low, high = fault.severity_interval
            found.append(low <= j.severity <= high)
    return found


def errors(judged: Sequence[Judged]) -> np.ndarray:
    """Return the relative errors of the severity, of those whose class is named."""
    pairs = [(j.fault, j.severity) for j in judged]
    return np.array([abs((f.severity or 0.0) - truth) / truth for f, truth in pairs
                     if f is not None and f.severity is not None])
