"""When each fault was announced and confirmed over a sequence of flights, and when it went.

One flight alone may err; k of the last n that answered are needed to confirm. With a rate p
of false announcements a flight, independent from flight to flight, a window of three confirms
falsely at 3 p² − 2 p³ with the rule 2 of 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ema_prognostics.trend.flights import Flight
from ema_record.errors import UsageError

FOUND, ABSENT, NO_ANSWER = 1, 0, -1
CLEAR = 3
"""Flights in a row without a confirmed fault after which it counts as gone.

A fault that one flight finds with 90 % is missed by three in a row once in a thousand times.
"""
WIDTH = 3
"""Flights on either side of a fall."""


class ConfirmationRule(NamedTuple):
    """A fault is confirmed when it is found in `k` of the last `n` flights that answered."""

    k: int = 2
    n: int = 3


DEFAULT_RULE = ConfirmationRule()


def parse_rule(text: str) -> ConfirmationRule:
    """Return the rule ``K/N``; UsageError if it is none."""
    k, separator, n = text.partition("/")
    if separator and k.strip().isdecimal() and n.strip().isdecimal():
        rule = ConfirmationRule(int(k), int(n))
        if 1 <= rule.k <= rule.n <= 50:
            return rule
    raise UsageError(f"rule {text!r}: give K/N with 1 <= K <= N <= 50, for example 2/3")


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """One fault over the flights of an actuator; all arrays have shape (n,).

    Attributes
    ----------
    fault_class, phase : of the fault.
    unit : of the severity.
    number : of each flight.
    state : `FOUND`, `ABSENT` or `NO_ANSWER`.
    severity, lower, upper : of the flights that found it, NaN elsewhere.
    """

    fault_class: str
    phase: str | None
    unit: str | None
    number: np.ndarray
    state: np.ndarray
    severity: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """A stretch of flights in which a fault was there; numbers are those of flights.

    Attributes
    ----------
    first : first announcement.
    confirmed : flight that confirmed it, or None.
    last : last flight that found it.
    cleared : first flight without it, once it counts as gone, or None.
    repaired : gone although it had outgrown the size at which it was first found: not a
        lapse of the detection.
    """

    first: int
    confirmed: int | None
    last: int
    cleared: int | None = None
    repaired: bool = False


def histories(flights: Sequence[Flight]) -> list[History]:
    """Return one history a fault (class and phase), in the order of first announcement."""
    keys: dict[tuple[str, str | None], str | None] = {}
    for flight in flights:
        for fault in flight.verdict.faults if flight.answered else ():
            keys.setdefault((fault.fault_class, fault.phase), fault.severity_unit)
    return [_history(flights, *key, unit) for key, unit in keys.items()]


def _history(
    flights: Sequence[Flight], fault_class: str, phase: str | None, unit: str | None
) -> History:
    count = len(flights)
    state = np.full(count, NO_ANSWER)
    values = np.full((3, count), np.nan)
    for at, flight in enumerate(flights):
        if not flight.answered:
            continue
        state[at] = ABSENT
        for fault in flight.verdict.faults:
            if (fault.fault_class, fault.phase) != (fault_class, phase):
                continue
            state[at] = FOUND
            if fault.severity is not None:
                bounds = fault.severity_interval or (fault.severity, fault.severity)
                values[:, at] = (fault.severity, *bounds)
    return History(
        fault_class=fault_class, phase=phase, unit=unit,
        number=np.array([f.number for f in flights]), state=state,
        severity=values[0], lower=values[1], upper=values[2],
    )


def episodes(history: History, rule: ConfirmationRule = DEFAULT_RULE) -> list[Episode]:
    """Return the stretches of flights in which the fault was there.

    An announcement that is not confirmed ends after `rule.n` flights without it, a confirmed
    one after as many, at least `CLEAR`. Flights without an answer count neither way.
    """
    found: list[Episode] = []
    judged = np.flatnonzero(history.state != NO_ANSWER)
    window: list[bool] = []
    current: Episode | None = None
    absent: list[int] = []
    for at in judged:
        here, number = history.state[at] == FOUND, int(history.number[at])
        if current is None and here:
            current, window, absent = Episode(first=number, confirmed=None, last=number), [], []
        if current is None:
            continue
        window = [*window, bool(here)][-rule.n:]
        if here:
            confirmed = current.confirmed
            if confirmed is None and sum(window) >= rule.k:
                confirmed = number
            current = replace(current, confirmed=confirmed, last=number)
            absent = []
        else:
            absent.append(number)
        if len(absent) >= (rule.n if current.confirmed is None else max(rule.n, CLEAR)):
            found.append(_closed(history, current, absent[0]))
            current = None
    return found if current is None else [*found, current]


def _closed(history: History, episode: Episode, cleared: int) -> Episode:
    inside = (history.number >= episode.first) & (history.number <= episode.last)
    lower = history.lower[inside & np.isfinite(history.lower)]
    severity = history.severity[inside & np.isfinite(history.severity)]
    outgrown = len(lower) >= 3 and float(np.median(lower[-3:])) > float(severity[0])
    return replace(episode, cleared=cleared, repaired=episode.confirmed is not None and outgrown)


def falls(history: History) -> list[int]:
    """Return the flights from which on the fault, still found, is clearly smaller.

    Degradation does not heal: where the intervals of `WIDTH` flights lie below those of the
    `WIDTH` before them (medians of the bounds), something was repaired or replaced.
    """
    found = np.flatnonzero(np.isfinite(history.severity))
    steps: list[int] = []
    begin, at = 0, WIDTH
    while at <= len(found) - WIDTH:
        before, after = found[max(begin, at - WIDTH):at], found[at:at + WIDTH]
        if np.median(history.lower[before]) <= np.median(history.upper[after]):
            at += 1
            continue
        # The medians see it up to half a width early: it is where the mean falls most.
        near = range(at, min(at + WIDTH, len(found) - WIDTH + 1))
        at = max(near, key=lambda k: _mean_drop(history, found, k))
        steps.append(int(history.number[found[at]]))
        begin, at = at, at + WIDTH
    return steps


def _mean_drop(history: History, found: np.ndarray, at: int) -> float:
    """Return the mean severity of `WIDTH` flights before `at` less that of those after."""
    before, after = found[max(0, at - WIDTH):at], found[at:at + WIDTH]
    return float(history.severity[before].mean() - history.severity[after].mean())
