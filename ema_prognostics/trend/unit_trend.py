"""`trend_of`: what the flights of one actuator say together.

Announced, confirmed and gone (`announcement`); how fast it grows and when it reaches the
next level (`growth`, `forecast`); what grows below what a flight can announce (`evidence`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from ema_prognostics.cascade.classes import LEVELS, levels_of
from ema_prognostics.trend.announcement import (
    DEFAULT_RULE,
    ConfirmationRule,
    Episode,
    History,
    episodes,
    falls,
    histories,
)
from ema_prognostics.trend.evidence import suspicion
from ema_prognostics.trend.flights import Flight
from ema_prognostics.trend.forecast import Outlook, forecast, outlook
from ema_prognostics.trend.growth import Growth, growth
from ema_prognostics.verdict.verdict import plain
from ema_prognostics.words import class_name
from ema_record.errors import library
from ema_record.record import html_of, iso_time

NAMES = ("medium", "large")
"""Levels that lie ahead of a small fault, in their order."""
LIMIT = "limit"
"""Level of one's own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelForecast:
    """Flight at which a level is reached, with 90 % interval; None: no end in sight."""

    level: str
    severity: float
    flight: int | None
    interval: tuple[int, int | None]

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        return {**asdict(self), "interval": list(self.interval)}


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultTrend:
    """One fault over the flights.

    Attributes
    ----------
    history : flight by flight.
    episodes : stretches in which it was there.
    falls : flights from which on it is there and clearly smaller.
    growth : since the last repair; None: too few flights with a severity.
    forecasts : of the levels ahead; empty without growth.
    outlook : severity and rate now, process by process; None without growth.
    """

    history: History
    episodes: tuple[Episode, ...]
    falls: tuple[int, ...]
    growth: Growth | None
    forecasts: tuple[LevelForecast, ...]
    outlook: Outlook | None = None

    @property
    def present(self) -> bool:
        """Whether it is confirmed and not gone at the end of the sequence."""
        last = self.episodes[-1]
        return last.confirmed is not None and last.cleared is None

    @property
    def announced(self) -> int:
        """Flight of the first announcement."""
        return self.episodes[0].first

    @property
    def confirmed(self) -> int | None:
        """Flight of the first confirmation."""
        return next((e.confirmed for e in self.episodes if e.confirmed is not None), None)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        rise = self.growth
        return {
            "fault_class": self.history.fault_class, "phase": self.history.phase,
            "severity_unit": self.history.unit, "announced": self.announced,
            "confirmed": self.confirmed, "present": self.present,
            "episodes": [asdict(episode) for episode in self.episodes],
            "falls": list(self.falls),
            "growth": None if rise is None else {
                "flights": rise.count, "growing": rise.growing, "rate": plain(rise.rate),
                "rate_interval": plain(rise.rate_interval), "p_value": plain(rise.p_value),
                "severity": plain(rise.severity)},
            "forecasts": [f.to_dict() for f in self.forecasts],
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitTrend:
    """What the flights of one actuator say together.

    Attributes
    ----------
    serial_number : of the actuator.
    flights : in order.
    faults : in the order of their first announcement.
    suspected : classes that grow though no flight announced them by then, with the flight.
    """

    serial_number: str
    flights: tuple[Flight, ...]
    faults: tuple[FaultTrend, ...]
    suspected: dict[str, int]

    @property
    def unanswered(self) -> tuple[int, ...]:
        """Flights that say neither healthy nor faulty; a copy is none of them."""
        return tuple(f.number for f in self.flights
                     if not f.answered and f.repeat_of is None)

    @property
    def undated(self) -> tuple[int, ...]:
        """Flights whose date cannot be, which stand where their bags' names put them."""
        return tuple(f.number for f in self.flights
                     if f.start_time and not f.time and f.repeat_of is None)

    @property
    def copies(self) -> tuple[int, ...]:
        """Numbers of the flights of which there are copies, once a copy; these count no more."""
        return tuple(f.number for f in self.flights if f.repeat_of is not None)

    def __repr__(self) -> str:
        faults = ", ".join(
            class_name(f.history.fault_class, f.history.phase)
            + (" present" if f.present else " not confirmed" if f.confirmed is None else " gone")
            for f in self.faults)
        return (f"<UnitTrend {self.serial_number or 'unknown'}: {len(self.flights)} flights, "
                f"{faults or 'no fault'}>")

    def _repr_html_(self) -> str:
        return html_of(repr(self)[1:-1], (
            (f"flight {f.number}", f"{iso_time(f.start_time) or ''} {f.verdict!r}")
            for f in self.flights))

    def to_pandas(self) -> Any:
        """Return a DataFrame of a row a flight: outcome and the largest fault."""
        pandas = library("pandas", "to_pandas", "use to_dict()")
        return pandas.DataFrame([
            {"flight": f.number, "start_time": iso_time(f.start_time), "outcome":
             f.verdict.outcome, **(f.verdict.faults[0].to_dict() if f.verdict.faults else {})}
            for f in self.flights]).set_index("flight")

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``ema trend --json``."""
        return {
            "serial_number": self.serial_number, "flights": len(self.flights),
            "unanswered": list(self.unanswered), "copies": list(self.copies),
            "faults": [f.to_dict() for f in self.faults], "suspected": dict(self.suspected),
        }


def trend_of(
    serial_number: str, flights: Sequence[Flight], rule: ConfirmationRule = DEFAULT_RULE,
    limits: Mapping[str, float] = MappingProxyType({}),
) -> UnitTrend:
    """Return the trend of one actuator.

    Parameters
    ----------
    serial_number : of the actuator.
    flights : of `flights.by_unit`: of one actuator, in order.
    rule : of confirmation.
    limits : severities of one's own that are forecast too, by class of fault.
    """
    faults = tuple(_fault_trend(h, rule, limits) for h in histories(flights))
    return UnitTrend(
        serial_number=serial_number, flights=tuple(flights), faults=faults,
        suspected=_suspected(flights, faults),
    )


def _fault_trend(
    history: History, rule: ConfirmationRule, limits: Mapping[str, float]
) -> FaultTrend:
    found = tuple(episodes(history, rule))
    steps = tuple(at for at in falls(history) if not _told(at, found, history))
    begin = max([e.cleared for e in found if e.cleared is not None] + [*steps, 1])
    used = np.isfinite(history.severity) & (history.number >= begin)
    seen = (history.number[used], history.severity[used], history.lower[used],
            history.upper[used])
    rise = growth(*seen)
    view = None if rise is None else outlook(*seen, rise)
    ahead = () if view is None else _ahead(history, view, limits)
    return FaultTrend(history=history, episodes=found, falls=steps, growth=rise, forecasts=ahead,
                      outlook=view)


def _told(at: int, found: Sequence[Episode], history: History) -> bool:
    """Whether a fall is the end of an episode seen again: nothing was found between the two."""
    seen = history.number[np.isfinite(history.severity)]
    return any(e.cleared is not None and e.cleared <= at
               and not ((seen >= e.cleared) & (seen < at)).any() for e in found)


def _ahead(
    history: History, view: Outlook, limits: Mapping[str, float]
) -> tuple[LevelForecast, ...]:
    now = int(history.number[np.isfinite(history.severity)][-1])
    found = []
    levels = dict(zip(NAMES, levels_of(history.fault_class)))
    if history.fault_class in limits:
        levels[LIMIT] = limits[history.fault_class]
    for name, severity in sorted(levels.items(), key=lambda item: item[1]):
        if (coming := forecast(view, severity)) is not None:
            flight, interval = coming.after(now)
            found.append(LevelForecast(
                level=name, severity=severity, flight=flight, interval=interval))
    return tuple(found)


def _suspected(flights: Sequence[Flight], faults: Sequence[FaultTrend]) -> dict[str, int]:
    """Return the classes that the sequential test finds before any flight announces them."""
    found: dict[str, int] = {}
    for name in LEVELS:
        own = [e for f in faults if f.history.fault_class == name for e in f.episodes]
        begin = max([e.cleared for e in own if e.cleared is not None], default=1)
        at = suspicion(flights, name, begin=begin)
        first = min((e.first for e in own if e.first >= begin), default=None)
        if at is not None and (first is None or at < first):
            found[name] = at
    return found
