"""`Verdict`: what the diagnosis says of one record, the object of ``ema check --json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, NamedTuple

from ema_prognostics.words import ENGLISH, fault_words, feature_words

Outcome = Literal["healthy", "fault", "unknown", "incomplete", "invalid"]
DIGITS = 6
"""Significant digits of a number in the JSON object."""
TOLD = 5
"""The same of a symptom."""
Measure = Literal["healthy", "bound"]
EXIT_STATUS: dict[Outcome, int] = {
    "healthy": 0, "fault": 1, "unknown": 3, "incomplete": 3, "invalid": 2,
}
_WORST_FIRST = (2, 4, 1, 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault that is present."""

    fault_class: str
    """turn_short, rotor_eccentricity, friction or backlash."""
    phase: str | None = None
    """a, b or c, where the fault has one."""
    severity: float | None = None
    """In `severity_unit`; None where the record does not tell."""
    severity_unit: str | None = None
    severity_interval: tuple[float, float] | None = None
    """90 % interval."""
    level: str | None = None
    """small, medium or large."""

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        return {name: plain(value) for name, value in asdict(self).items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Symptom:
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
        found = {name: plain(value, TOLD) for name, value in asdict(self).items()}
        return {"feature": self.feature, "words": feature_words(self.feature, ENGLISH), **found}


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What one record says of the actuator."""

    outcome: Outcome
    faults: tuple[Fault, ...] = ()
    """Largest first; empty unless `outcome` is ``fault``."""
    alternatives: tuple[str, ...] = ()
    """Classes that the record cannot tell from what is named.

    The probability of one that looks like the fault that is named is part of that fault's own.
    """
    probabilities: dict[str, float] = field(default_factory=dict)
    reasons: tuple[str, ...] = ()
    """In words."""
    bag: str = ""
    cause: str = ""
    """Why there is no answer: ``unlike``, ``unlike_since_baseline``, ``doubt``, ``too_small``,
    ``unknown_test``, ``missing_feature``, ``not_done``, ``record``, ``rig``, or the name of a
    rule of the record checks; empty where there is one."""
    evidence: tuple[Symptom, ...] = ()
    """The numbers that say the most, largest first."""
    side: str | None = None
    """Of a friction that is found, where it is most likely: motor or surface."""
    actuator: str = ""
    """Name of the actuator among those of the aircraft; empty: it has none."""

    @property
    def exit_status(self) -> int:
        """Exit status of a program that reports this verdict."""
        return EXIT_STATUS[self.outcome]

    def __repr__(self) -> str:
        faults = ", ".join(
            fault_words(f.fault_class, f.phase, f.severity, f.severity_interval)
            for f in self.faults)
        return f"<Verdict {self.outcome.upper()}{': ' if faults else ''}{faults}>"

    def _repr_html_(self) -> str:
        from ema_record.record import html_of

        sure = ", ".join(f"{n} {100 * p:.1f} %" for n, p in self.probabilities.items())
        return html_of(repr(self)[1:-1], (
            ("bag", self.bag), ("probabilities", sure), *(("reason", r) for r in self.reasons)))

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``ema check --json``; every key but one is always there.

        ``actuator`` is there where it has a name. The largest fault stands at the top and is the
        first of `faults`.
        """
        return {
            "bag": self.bag,
            **({"actuator": self.actuator} if self.actuator else {}),
            "verdict": self.outcome,
            **(self.faults[0].to_dict() if self.faults else dict.fromkeys(Fault.__slots__)),
            "faults": [f.to_dict() for f in self.faults],
            "alternatives": list(self.alternatives),
            "probabilities": {
                name: round(float(p), DIGITS) for name, p in self.probabilities.items()
            },
            "reasons": list(self.reasons),
            "cause": self.cause or None,
            "evidence": [e.to_dict() for e in self.evidence],
            "side": self.side,
        }


class Judged(NamedTuple):
    """A verdict, and which test it is of."""

    verdict: Verdict
    serial_number: str = ""
    """Of the actuator, empty where the bag could not be read."""
    start_time: int = 0
    """Acceptance of the command (ns since the epoch), 0 where not known."""
    profile: str = ""
    """Name of the test, empty where not known."""


def verdict_of_dict(found: Mapping[str, Any]) -> Verdict:
    """Return the verdict that a JSON object tells, as far as flights are compared by it."""
    return Verdict(
        outcome=found["verdict"], bag=found["bag"], alternatives=tuple(found["alternatives"]),
        faults=tuple(Fault(**{**fault, "severity_interval": None if
                              fault["severity_interval"] is None
                              else tuple(fault["severity_interval"])})
                     for fault in found["faults"]),
        probabilities=dict(found["probabilities"]), reasons=tuple(found["reasons"]),
    )


def worst_status(statuses: list[int]) -> int:
    """Return the exit status of several bags or tests: 2 before 4 before 1 before 3 before 0."""
    return next((status for status in _WORST_FIRST if status in statuses), 0)


def plain(value: Any, digits: int = DIGITS) -> Any:
    """Return a JSON value: a number with so many digits, an interval as a list; others stay."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, tuple | list):
        return [plain(v, digits) for v in value]
    return float(f"{value:.{digits}g}")
