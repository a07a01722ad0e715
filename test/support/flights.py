"""Flights made of a short notation, for the tests of the trend."""

from dataclasses import replace

from ema_prognostics.trend.flights import Flight, in_order
from ema_prognostics.verdict.verdict import Fault, Verdict

HALF = 0.05


def fault(severity):
    return Verdict(outcome="fault", faults=(Fault(
        fault_class="turn_short", phase="b", severity=severity, severity_unit="1",
        severity_interval=(severity * (1 - HALF), severity * (1 + HALF)),
    ),), probabilities={"turn_short": 0.99})


def verdict_of(mark, p=0.01):
    """Return a verdict: a severity, ``.`` healthy, ``?`` unknown, ``x`` damaged."""
    if isinstance(mark, int | float):
        return fault(float(mark))
    outcome = {".": "healthy", "?": "unknown", "x": "invalid"}[mark]
    return Verdict(outcome=outcome, probabilities={} if mark == "x" else {"turn_short": p})


def flights_of(marks, probabilities=None):
    """Return flights in order, one a mark."""
    flights = []
    for n, mark in enumerate(marks, start=1):
        p = 0.01 if probabilities is None else probabilities[n - 1]
        flights.append(Flight(
            verdict=replace(verdict_of(mark, p), bag=f"flight_{n}"),
            serial_number="" if mark == "x" else "SN-1", start_time=0 if mark == "x" else 10 * n,
        ))
    return in_order(flights)
