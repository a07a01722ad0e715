"""The flights of an actuator in their order: of which unit, when.

A flight is one bag and its verdict. Nothing is left out: a bag that cannot be read is a flight
without an answer.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from time import time_ns

from ema_prognostics.verdict.verdict import Verdict
from ema_record.bag.find import natural

MOST_DATE = 4_000_000_000 * 10**9
"""Beyond this no date is told (ns since the epoch)."""
EARLIEST, DAY = 978_307_200 * 10**9, 86_400 * 10**9
"""The year 2001: clocks that were not set begin at 1970, 1980 or 2000. How far the clocks of a
recorder and of this computer may be apart (ns)."""
_BEST_FIRST = ("fault", "healthy", "unknown", "incomplete", "invalid")
"""Which of several copies counts; a fault is never hidden by a copy that does not show it."""


def possible_time(start_time: int) -> bool:
    """Whether a test can have begun then (ns since the epoch)."""
    return EARLIEST <= start_time <= time_ns() + DAY


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """One test of an actuator and what it says.

    Attributes
    ----------
    verdict : with the name of the bag.
    serial_number : of the actuator, empty where the bag could not be read.
    start_time : acceptance of the command (ns since the epoch), 0 where not known.
    number : place in the sequence of this actuator, from 1.
    repeat_of : number of the flight that this one is a copy of, or None.
    profile : name of the test, empty where not known.
    """

    verdict: Verdict
    serial_number: str = ""
    start_time: int = 0
    number: int = 0
    repeat_of: int | None = None
    profile: str = ""

    @property
    def time(self) -> int:
        """`start_time`, 0 where it cannot be: of a clock that was not set, or runs ahead."""
        return self.start_time if possible_time(self.start_time) else 0

    @property
    def answered(self) -> bool:
        """Whether the test says healthy or faulty, and is not a copy of another one."""
        return self.verdict.outcome in ("healthy", "fault") and self.repeat_of is None


def in_order(flights: Iterable[Flight]) -> list[Flight]:
    """Return flights of one actuator by the time of their tests, numbered from 1.

    Equal times stand in the natural order of the bags' names. A flight whose time is not known
    (its bag is damaged, tells none, or one that cannot be) stands after the bag that precedes it
    by name. Flights of the same start time that say the same are copies of one test, and so is
    what cannot be read of one: the one that tells most counts (`_BEST_FIRST`), the whole record
    before one that was recovered from a part of it; the others have its number.
    """
    placed: list[tuple[int, int, Flight]] = []
    last = 0
    for flight in sorted(flights, key=lambda f: natural(f.verdict.bag)):
        last = flight.time or last
        placed.append((last, len(placed), flight))
    placed.sort(key=lambda item: item[:2])
    told: dict[int, str] = {}
    for *_, flight in placed:
        if said := _said(flight):
            told.setdefault(flight.start_time, said)
    tests: dict[tuple[int, str], list[Flight]] = {}
    for place, (*_, flight) in enumerate(placed):
        said = _said(flight) or told.get(flight.start_time, "")
        key = (flight.start_time, said) if flight.start_time else (-1 - place, "")
        tests.setdefault(key, []).append(flight)
    ordered = []
    for number, copies in enumerate(tests.values(), start=1):
        counts = min(copies, key=lambda f: _BEST_FIRST.index(f.verdict.outcome))
        ordered += [replace(f, number=number, repeat_of=None if f is counts else number)
                    for f in copies]
    return ordered


def _said(flight: Flight) -> str:
    """Return what a test says, the same of each copy; empty where its bag cannot be read."""
    verdict = flight.verdict
    if verdict.outcome in ("incomplete", "invalid"):
        return ""
    return repr((flight.profile, verdict.outcome, verdict.faults, sorted(
        verdict.probabilities.items())))


def by_unit(flights: Iterable[Flight], *, one: bool = True) -> dict[str, list[Flight]]:
    """Return the flights of each actuator, in order; units in the order of their numbers.

    Flights that cannot be read are a group of their own, under an empty serial number; with
    `one` they count with the only actuator there is, if there is only one.
    """
    flights = list(flights)
    units = sorted({f.serial_number for f in flights if f.serial_number}, key=natural)
    only = units[0] if one and len(units) == 1 else ""
    grouped: dict[str, list[Flight]] = {unit: [] for unit in units}
    for flight in flights:
        grouped.setdefault(flight.serial_number or only, []).append(flight)
    return {unit: in_order(found) for unit, found in grouped.items()}


def date_of(flights: Sequence[Flight], number: int) -> datetime | None:
    """Return when a flight was, or will be if the last ten go on at their pace; None: not known.

    Parameters
    ----------
    flights : of one actuator, in order.
    number : from 1, beyond the last one for what is ahead.
    """
    times = {f.number: f.time for f in flights if f.time}
    at, known = times.get(number), list(times.items())
    if at is None and len(known) > 1 and number > known[-1][0]:
        (first, begin), (last, end) = known[-min(10, len(known))], known[-1]
        at = end + round((end - begin) / (last - first) * (number - last))
    if at is None or at > MOST_DATE:
        return None
    return datetime.fromtimestamp(at / 1e9, tz=timezone.utc)
