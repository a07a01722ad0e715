"""`Fleet`: the units of the bags below folders, each with its trend, worst first."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ema_prognostics.cascade.classes import LEVELS, level_of, levels_of
from ema_prognostics.fleet.judging import JudgeSettings, Objects, judged_fleet
from ema_prognostics.fleet.tables import COLUMNS, rows_of
from ema_prognostics.trend.announcement import DEFAULT_RULE, ConfirmationRule
from ema_prognostics.trend.flights import Flight, by_unit
from ema_prognostics.trend.unit_trend import FaultTrend, UnitTrend, trend_of
from ema_prognostics.verdict.verdict import verdict_of_dict
from ema_prognostics.words import class_name, fault_words
from ema_record.bag.find import bags_below, natural
from ema_record.errors import library
from ema_record.record import html_of, iso_time

State = Literal["fault", "suspected", "no answer", "healthy"]
STATES: tuple[State, ...] = ("fault", "suspected", "no answer", "healthy")
"""Of a unit, worst first: a confirmed fault; one that is announced, or grows unannounced; a last
test without an answer; none of these."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetUnit:
    """One actuator of the fleet.

    Attributes
    ----------
    trend : over its flights.
    objects : JSON object of the verdict of each flight, in their order.
    """

    trend: UnitTrend
    objects: tuple[dict[str, Any], ...]

    @property
    def serial_number(self) -> str:
        """Of the actuator, empty for bags that do not tell it."""
        return self.trend.serial_number

    @property
    def last(self) -> Flight:
        """The last flight that is no copy of another."""
        return [f for f in self.trend.flights if f.repeat_of is None][-1]

    @property
    def silent(self) -> Flight | None:
        """The last test if it gave no answer; without a serial number any such test."""
        tests = [f for f in self.trend.flights if f.repeat_of is None]
        silent = [f for f in (tests[-1:] if self.serial_number else tests) if not f.answered]
        return silent[-1] if silent else None

    @property
    def worst(self) -> FaultTrend | None:
        """The fault that counts: confirmed before announced, then nearest to large.

        Bags without a serial number may be of several units: none clears another.
        """
        there = [f for f in self.trend.faults
                 if f.episodes[-1].cleared is None or not self.serial_number]
        return max(there, key=lambda f: (f.present, share_of_large(f)), default=None)

    @property
    def state(self) -> State:
        """What the unit needs, see `STATES`."""
        if any(f.present for f in self.trend.faults):
            return "fault"
        if self.worst is not None or self.trend.suspected:
            return "suspected"
        return "healthy" if self.silent is None else "no answer"

    def finding(self) -> str:
        """Return the worst fault in words, or why there is no answer."""
        fault = self.worst
        if fault is not None:
            name, (now, interval) = fault.history.fault_class, _last_severity(fault)
            level = f", {level_of(name, now)}" if now is not None and name in LEVELS else ""
            return fault_words(name, fault.history.phase, now, interval) + level
        if self.trend.suspected:
            return f"{class_name(next(iter(self.trend.suspected)))} grows"
        if self.silent is not None:
            verdict = self.silent.verdict
            text = next(iter(verdict.reasons), "")
            return f"{verdict.outcome}: {text.removeprefix(f'{verdict.bag}: ')}"
        return ""

    def ahead(self) -> str:
        """Return when the next level is reached, empty where nothing grows."""
        for level in self.worst.forecasts if self.worst is not None else ():
            now = self.trend.flights[-1].number
            first, last = level.interval
            until = f"to {max(last - now, 0)}" if last is not None else "or more"
            return f"{level.level} in {max(first - now, 0)} {until} flights"
        return ""


def share_of_large(fault: FaultTrend) -> float:
    """Return the severity now, of that from which on the fault is large."""
    name, now = fault.history.fault_class, _last_severity(fault)[0]
    return 0.0 if now is None or name not in LEVELS else now / levels_of(name)[1]


def _last_severity(fault: FaultTrend) -> tuple[float | None, tuple[float, float] | None]:
    history = fault.history
    known = [k for k, value in enumerate(history.severity) if value == value]  # noqa: PLR0124
    if not known:
        return None, None
    k = known[-1]
    return float(history.severity[k]), (float(history.lower[k]), float(history.upper[k]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet:
    """The units, worst first."""

    units: tuple[FleetUnit, ...]

    def __repr__(self) -> str:
        bags = sum(len(u.objects) for u in self.units)
        states = ", ".join(f"{n} {s}" for s in STATES
                           if (n := sum(u.state == s for u in self.units)))
        return f"<Fleet of {len(self.units)} units, {bags} bags: {states}>"

    def _repr_html_(self) -> str:
        return html_of(repr(self)[1:-1], (
            (u.serial_number or "unknown", f"{u.state} {u.finding()}") for u in self.units))

    @property
    def objects(self) -> Objects:
        """JSON object of every bag, unit by unit."""
        return [found for unit in self.units for found in unit.objects]

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``ema fleet --json``."""
        return {"units": [
            {"state": u.state, "finding": u.finding(), "ahead": u.ahead(),
             "last_test": iso_time(u.last.start_time), "last_bag": u.last.verdict.bag,
             **u.trend.to_dict()} for u in self.units]}

    def to_pandas(self) -> Any:
        """Return a DataFrame of a row a fault, or a bag without one; see `tables.COLUMNS`."""
        pandas = library("pandas", "to_pandas", "use objects")
        return pandas.DataFrame([row for o in self.objects for row in rows_of(o)],
                                columns=list(COLUMNS))


def fleet_of(objects: Iterable[dict[str, Any]], rule: ConfirmationRule = DEFAULT_RULE) -> Fleet:
    """Return the fleet of the objects of `judging.judged_fleet`."""
    by_bag = {found["bag"]: found for found in objects}
    flights = [
        Flight(verdict=verdict_of_dict(found), serial_number=found["serial_number"] or "",
               start_time=found["start_time"], profile=found["profile"] or "")
        for found in by_bag.values()
    ]
    units = []
    for serial_number, own in by_unit(flights, one=False).items():
        trend = trend_of(serial_number, own, rule)
        units.append(FleetUnit(trend=trend, objects=tuple(
            {"flight": f.number, "repeat_of": f.repeat_of, **by_bag[f.verdict.bag]}
            for f in trend.flights)))
    return Fleet(units=tuple(sorted(units, key=_rank)))


def _rank(unit: FleetUnit) -> tuple[int, float, Any]:
    worst = unit.worst
    return (STATES.index(unit.state), -(0.0 if worst is None else share_of_large(worst)),
            natural(unit.serial_number))


def read_fleet(
    paths: Sequence[str | Path], *, model: str | Path | None = None,
    profile: str | Path | None = None, rule: ConfirmationRule = DEFAULT_RULE,
    jobs: int | None = None, dask: str | None = None, folder: Path | None = None,
    progress: Callable[[int, int], object] = lambda _done, _of: None,
) -> Fleet:
    """Judge all bags below folders, each once, and return the fleet.

    Parameters
    ----------
    paths : folders, searched to their depth, or bags.
    model, profile : as of `Judge`.
    rule : of confirmation.
    jobs, dask, folder : see `judging.judged_fleet`.
    progress : called with the number of bags that are done, and of all.

    Raises
    ------
    UsageError, InvalidRecordError, ModelError
    """
    bags = bags_below([Path(path) for path in paths])
    objects = judged_fleet(bags, JudgeSettings.of(model, profile), jobs=jobs, dask=dask,
                           folder=folder, progress=lambda done: progress(done, len(bags)))
    return fleet_of(objects, rule)
