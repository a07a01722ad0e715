"""Scores of sequences of flights: delay of announcements, false alarms, what was missed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from ema_prognostics.training.rates import Rate, rate
from ema_prognostics.trend.flights import Flight, in_order
from ema_prognostics.trend.unit_trend import UnitTrend, trend_of
from ema_prognostics.verdict.verdict import Verdict

VIEWS = ("fleet", "baseline")
CLASS_OF = {"motor_friction": "friction", "surface_friction": "friction"}
"""Class that a verdict names, where it is not the fault's own name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flown:
    """A unit with the verdicts on its flights."""

    unit: int
    kind: str
    detail: str
    repair: int | None
    severity: np.ndarray
    verdicts: dict[str, list[Verdict]]


@dataclass(slots=True, kw_only=True)
class Row:
    """Units of one kind of fault; delays in flights after passing the detectable severity."""

    units: int = 0
    passed: int = 0
    announced: int = 0
    confirmed: int = 0
    announce_delay: list[int] = field(default_factory=list)
    confirm_delay: list[int] = field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True)
class Passing:
    """One faulty unit: flights (from 1) of what happened, None where it did not."""

    unit: int
    passed: int | None
    announced: int | None
    confirmed: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """What one view gave over all units."""

    faults: dict[str, Row]
    rates: dict[str, Rate]
    notes: list[str]
    passings: list[Passing]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "faults": {k: asdict(v) for k, v in self.faults.items()},
            "rates": {k: r._asdict() for k, r in self.rates.items()}, "notes": self.notes,
            "passings": [asdict(p) for p in self.passings],
        }


def unit_trend(flown: Flown, view: str) -> UnitTrend:
    """Return what `ema trend` says of a unit's flights."""
    flights = in_order(
        Flight(verdict=replace(verdict, bag=f"flight_{n}"), serial_number=str(flown.unit),
               start_time=n)
        for n, verdict in enumerate(flown.verdicts[view], start=1)
    )
    return trend_of(str(flown.unit), flights)


def names_it(verdict: Verdict, kind: str, detail: str) -> bool:
    """Return whether a verdict names the fault: its class, and the phase of a short.

    A pair that cannot be told apart and is named as the pair counts.
    """
    name = CLASS_OF.get(kind, kind)
    for fault in verdict.faults:
        if fault.fault_class == name:
            return kind != "turn_short" or fault.phase == detail
    return verdict.outcome == "fault" and name in verdict.alternatives


def _first(where: np.ndarray) -> int | None:
    found = np.flatnonzero(where)
    return int(found[0]) + 1 if len(found) else None


def passing(flown: Flown, view: str, trend: UnitTrend, detectable: float) -> Passing:
    """Return when a fault passed the detectable severity, was announced and confirmed."""
    named = np.array([names_it(v, flown.kind, flown.detail) for v in flown.verdicts[view]])
    there = flown.severity > 0.0
    name = CLASS_OF.get(flown.kind, flown.kind)
    onset = _first(there)
    confirmed = [
        e.confirmed for f in trend.faults for e in f.episodes
        if f.history.fault_class == name and e.confirmed is not None
        and (flown.kind != "turn_short" or f.history.phase == flown.detail)
        and onset is not None and e.confirmed >= onset
        and (flown.repair is None or e.confirmed <= flown.repair)
    ]
    return Passing(
        unit=flown.unit, passed=_first(flown.severity >= detectable),
        announced=_first(named & there), confirmed=min(confirmed, default=None),
    )


def score_units(
    units: Sequence[Flown], view: str, detectable: dict[str, float]
) -> Score:
    """Return the scores of one view.

    Parameters
    ----------
    units : flown.
    view : fleet or baseline.
    detectable : severity by kind of fault.
    """
    rows = {kind: Row() for kind in detectable}
    trends = {u.unit: unit_trend(u, view) for u in units}
    passings = []
    for flown in units:
        if flown.kind not in rows:
            continue
        row = rows[flown.kind]
        found = passing(flown, view, trends[flown.unit], detectable[flown.kind])
        passings.append(found)
        row.units += 1
        if found.passed is None:
            continue
        row.passed += 1
        if found.announced is not None:
            row.announced += 1
            row.announce_delay.append(found.announced - found.passed)
        if found.confirmed is not None:
            row.confirmed += 1
            row.confirm_delay.append(found.confirmed - found.passed)
    passed = [p for p in passings if p.passed is not None]
    rates = {
        **_flight_rates(units, view, detectable),
        "units with a false alarm on any healthy flight":
            rate([_false_alarm(u, view) for u in units]),
        "units with a false confirmation":
            rate([_false_confirmation(u, trends[u.unit]) for u in units]),
        "faults past the detectable severity never announced":
            rate([p.announced is None for p in passed]),
        "the same, never confirmed by 2 of 3": rate([p.confirmed is None for p in passed]),
        "units falsely suspected by the sequential test":
            rate([_falsely_suspected(u, trends[u.unit]) for u in units]),
    }
    repaired = [u for u in units if u.repair is not None and _confirmed_before(u, passings)]
    rates["repairs recognised, of confirmed faults"] = rate(
        [_repair_seen(u, trends[u.unit]) for u in repaired])
    return Score(faults=rows, rates=rates, notes=_notes(passings, units, trends),
                 passings=passings)


def _flight_rates(
    units: Sequence[Flown], view: str, detectable: dict[str, float]
) -> dict[str, Rate]:
    """Return the rates that count single flights."""
    alarms, unsure, wrong, missed, dodged, covered = [], [], [], [], [], []
    for flown in units:
        for x, verdict in zip(flown.severity, flown.verdicts[view]):
            if x == 0.0:
                alarms.append(verdict.outcome == "fault")
                unsure.append(verdict.outcome not in ("fault", "healthy"))
                continue
            if verdict.outcome == "fault":
                right = names_it(verdict, flown.kind, flown.detail)
                wrong.append(not right)
                interval = verdict.faults[0].severity_interval
                if right and interval is not None:
                    covered.append(interval[0] <= x <= interval[1])
            if x >= detectable[flown.kind]:
                missed.append(verdict.outcome == "healthy")
                dodged.append(verdict.outcome not in ("fault", "healthy"))
    return {
        "false alarms, healthy flights": rate(alarms),
        "healthy flights without an answer": rate(unsure),
        "announced flights with the wrong class or phase": rate(wrong),
        "flights past the detectable severity called healthy": rate(missed),
        "flights past the detectable severity without an answer": rate(dodged),
        "severity inside its interval, announced flights": rate(covered),
    }


def _false_alarm(flown: Flown, view: str) -> bool:
    """Return whether a healthy flight announced a fault; flights of a unit hang together."""
    return any(v.outcome == "fault" for x, v in zip(flown.severity, flown.verdicts[view])
               if x == 0.0)


def _false_confirmation(flown: Flown, trend: UnitTrend) -> bool:
    """Return whether a fault was confirmed while the unit was still healthy."""
    onset = _first(flown.severity > 0.0) or len(flown.severity) + 1
    return any(
        e.confirmed is not None and e.confirmed < onset
        for f in trend.faults for e in f.episodes
    )


def _falsely_suspected(flown: Flown, trend: UnitTrend) -> bool:
    onset = _first(flown.severity > 0.0) or len(flown.severity) + 1
    return any(at < onset for at in trend.suspected.values())


def _confirmed_before(flown: Flown, passings: Sequence[Passing]) -> bool:
    own = next(p for p in passings if p.unit == flown.unit)
    return own.confirmed is not None


def _repair_seen(flown: Flown, trend: UnitTrend) -> bool:
    """Return whether the trend says that the fault was gone, from the flight of the repair."""
    assert flown.repair is not None
    first = flown.repair + 1
    return any(
        e.cleared is not None and abs(e.cleared - first) <= 2
        for f in trend.faults for e in f.episodes if e.confirmed is not None
    )


def _notes(
    passings: Sequence[Passing], units: Sequence[Flown], trends: dict[int, UnitTrend]
) -> list[str]:
    """Return what the sequential test gained on the announcements."""
    gained = []
    for found in passings:
        flown = next(u for u in units if u.unit == found.unit)
        name = CLASS_OF.get(flown.kind, flown.kind)
        at = trends[flown.unit].suspected.get(name)
        onset = _first(flown.severity > 0.0) or 0
        if at is not None and at >= onset:
            gained.append((found.announced or len(flown.severity) + 1) - at)
    if not gained:
        return ["the sequential test suspected no fault before its announcement"]
    return [
        f"the sequential test suspected {len(gained)} faults before their announcement, by "
        f"{np.median(gained):.0f} flights (median)"
    ]
