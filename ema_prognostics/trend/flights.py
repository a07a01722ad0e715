"""The flights of an actuator in their order: of which unit, when.

A flight is one bag and its verdict. Nothing is left out: a bag that cannot be read is a flight
without an answer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path

from ema_prognostics.verdict.verdict import Verdict
from ema_record.bag.find import natural

MOST_DATE = 4_000_000_000 * 10**9
"""Beyond this no date is told (ns since the epoch)."""
_BEST_FIRST = ("fault", "healthy", "unknown", "incomplete", "invalid")
"""Which of several copies counts; a fault is never hidden by a copy that does not show it."""


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
    def answered(self) -> bool:
        """Whether the test says healthy or faulty, and is not a copy of another one."""
        return self.verdict.outcome in ("healthy", "fault") and self.repeat_of is None


def in_order(flights: Iterable[Flight]) -> list[Flight]:
    """Return flights of one actuator by start time, numbered from 1.

    Equal times stand in the natural order of the bags' names. A flight whose time is not known
    (its bag is damaged, or tells none) stands after the bag that precedes it by name. Flights of
    the same start time are copies of one test: the one that tells most counts (`_BEST_FIRST`),
    the whole record before one that was recovered from a part of it.
    """
    by_name = sorted(flights, key=lambda f: natural(f.verdict.bag))
    keyed, last = [], 0
    for place, flight in enumerate(by_name):
        last = flight.start_time or last
        keyed.append((last, place, flight))
    keyed.sort(key=lambda item: item[:2])
    ordered = [replace(f, number=n) for n, (_, _, f) in enumerate(keyed, start=1)]
    counts: dict[int, int] = {}
    for flight in sorted(ordered, key=lambda f: _BEST_FIRST.index(f.verdict.outcome)):
        counts.setdefault(flight.start_time, flight.number)
    return [
        f if not f.start_time or counts[f.start_time] == f.number
        else replace(f, repeat_of=counts[f.start_time]) for f in ordered
    ]


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


def read_flights(
    bags: Sequence[Path], judge: Callable[[Path], Flight], progress: Callable[[int], None],
) -> dict[str, list[Flight]]:
    """Judge bags one by one and return the flights of each actuator, in order.

    Parameters
    ----------
    bags : one a flight.
    judge : from a bag to its flight; answers for any bag.
    progress : called with the number of bags done.
    """
    flights = []
    for done, bag in enumerate(bags, start=1):
        flights.append(judge(bag))
        progress(done)
    return by_unit(flights)


def date_of(flights: Sequence[Flight], number: int) -> datetime | None:
    """Return when a flight was, or will be if the last ten go on at their pace; None: not known.

    Parameters
    ----------
    flights : of one actuator, in order.
    number : from 1, beyond the last one for what is ahead.
    """
    known = [(f.number, f.start_time) for f in flights if f.start_time]
    at = dict(known).get(number)
    if at is None and len(known) > 1 and number > known[-1][0]:
        (first, begin), (last, end) = known[-min(10, len(known))], known[-1]
        at = end + round((end - begin) / (last - first) * (number - last))
    if at is None or at > MOST_DATE:
        return None
    return datetime.fromtimestamp(at / 1e9, tz=timezone.utc)
