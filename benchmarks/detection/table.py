"""The numbers of the detection benchmark, as plain data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.detection.judge import CLASS, Judged, detected, errors, inside, of, severities
from ema_prognostics.training.rates import ORIGIN, Rate, detection_curve, rate

PHASED = "turn_short"
MODES = ("paper", "common", "shifted")
TARGETS: dict[str, tuple[float, float]] = {  # own baseline, fleet
    "turn_short": (0.005, 0.015), "rotor_eccentricity": (0.006, 0.008),
    "motor_friction": (0.05, 0.30), "surface_friction": (0.05, 0.30), "backlash": (1.5e-4, 2e-4),
}
"""Of a90/95, in the fault's own unit."""
BINS: dict[str, tuple[Callable[[Judged], float], tuple[float, ...]]] = {
    "winding temperature (degC)": (
        lambda j: float(j.case.effects["winding_temperature.temperature"]), (0.0, 35.0)),
    "bus voltage (part)": (
        lambda j: float(j.case.effects["bus_voltage_change.change"]), (-0.033, 0.033)),
    "surface load (N m)": (
        lambda j: float(j.case.effects["surface_load.constant"]), (-6.3, 6.3)),
    "sensor noise (times)": (lambda j: j.case.noise, (0.8, 1.25)),
    "largest sensor offset (A)": (
        lambda j: max(abs(float(j.case.effects[f"current_sensor_offset.phase_{p}"]))
                      for p in "abc"), (0.03, 0.04)),
}
"""Conditions, and the bounds between their low, middle and high third."""


def plain(found: Rate) -> dict[str, Any]:
    """Return a rate as plain data."""
    return {"hits": found.hits, "total": found.total, "value": found.value,
            "lower": found.lower, "upper": found.upper}


def fault_groups(judged: Sequence[Judged]) -> dict[str, list[Judged]]:
    """Return the records of each fault, and of each mode of the eccentricity."""
    groups = {name: of(judged, name) for name in CLASS}
    for mode in MODES:
        groups[f"rotor_eccentricity, {mode}"] = [
            j for j in groups["rotor_eccentricity"] if j.case.detail == mode]
    return groups


def fault_numbers(judged: Sequence[Judged]) -> dict[str, Any]:
    """Return detection, class, severity and coverage of the records of one fault."""
    found = detected(judged)
    group = judged[0].case.group if judged else ""
    curve = detection_curve(severities(judged), found, ORIGIN.get(group, 0.0))
    in_log = detection_curve(severities(judged), found)
    named = [j for j in judged if j.detected]
    error = errors(judged)
    phases = [j.fault.phase == j.case.detail for j in named
              if j.case.group == PHASED and j.fault is not None]
    return {
        "detected": plain(rate(found)),
        "unknown": plain(rate([j.outcome == "unknown" for j in judged])),
        "a90": None if curve is None else curve.a90,
        "a90_95": None if curve is None else curve.a90_95,
        "a90_95 in log severity": None if in_log is None else in_log.a90_95,
        "curve": None if curve is None else [curve.intercept, curve.slope, curve.origin],
        "right class": plain(rate([j.right for j in named])),
        "phase right": plain(rate(phases)),
        "interval holds": plain(rate(inside(judged))),
        "median error": float(np.median(error)) if len(error) else None,
    }


def wrong(judged: Sequence[Judged], visible: dict[str, float]) -> list[Judged]:
    """Return the wrong verdicts.

    A healthy record or a stranger called a fault, a fault called another, a fault of at least
    the severity `visible` called healthy, a stranger called healthy.
    """
    found = []
    for j in judged:
        group = j.case.group
        if group == "healthy":
            bad = j.detected
        elif group in ("stranger", "sensor"):
            bad = j.detected or j.outcome == "healthy"
        elif group == "pair":
            bad = j.detected and not {f.fault_class for f in j.verdict.faults} <= j.truth
        else:
            missed = j.outcome == "healthy" and j.severity >= visible.get(group, np.inf)
            bad = missed or (j.detected and not j.right)
        if bad:
            found.append(j)
    return found


def confusion(judged: Sequence[Judged], visible: dict[str, float]) -> dict[str, dict[str, int]]:
    """Return how often each truth is called what; single faults from `visible` on."""
    table: dict[str, Counter[str]] = {}
    for j in judged:
        group = j.case.group
        if group in CLASS and j.severity < visible.get(group, 0.0):
            continue
        table.setdefault(group, Counter())[j.outcome] += 1
    return {name: dict(counts) for name, counts in table.items()}


def accuracy(judged: Sequence[Judged], visible: dict[str, float]) -> Rate:
    """Return how often a healthy record or a fault from `visible` on is called what it is."""
    kept = [j for j in judged if j.case.group == "healthy" or (
        j.case.group in visible and j.severity >= visible[j.case.group])]
    return rate([j.outcome == "healthy" if j.case.group == "healthy" else j.right for j in kept])


def by_condition(judged: Sequence[Judged], visible: dict[str, float]) -> dict[str, Any]:
    """Return false alarms, accuracy and coverage in each third of each condition."""
    result: dict[str, Any] = {}
    known = of(judged, "healthy", *CLASS)
    for name, (value, bounds) in BINS.items():
        place = np.searchsorted(bounds, [value(j) for j in known])
        for k, label in enumerate(("low", "middle", "high")):
            part = [j for j, p in zip(known, place) if p == k]
            result[f"{name}, {label}"] = {
                "false alarms": plain(rate(detected(of(part, "healthy")))),
                "accuracy": plain(accuracy(part, visible)),
                "interval holds": plain(rate(inside(of(part, *CLASS)))),
            }
    return result


def reliability(judged: Sequence[Judged], bins: int = 10) -> list[dict[str, float]]:
    """Return, by the probability given to a class, how often the class is there."""
    p, there = [], []
    for j in of(judged, "healthy", "pair", *CLASS):
        for name in set(CLASS.values()):
            if name in j.verdict.probabilities:
                p.append(j.verdict.probabilities[name])
                there.append(name in j.truth)
    place = np.clip((np.array(p) * bins).astype(int), 0, bins - 1)
    rows = []
    for k in range(bins):
        here = place == k
        if here.any():
            r = rate(np.array(there)[here])
            rows.append({"probability": float(np.array(p)[here].mean()), "observed": r.value,
                         "lower": r.lower, "upper": r.upper, "n": r.total})
    return rows


def numbers(judged: Sequence[Judged], visible: dict[str, float]) -> dict[str, Any]:
    """Return all numbers of one view.

    Parameters
    ----------
    judged : verdicts on the held-out fleet.
    visible : severity of each group from which a miss counts as wrong.
    """
    healthy = of(judged, "healthy")
    mistakes = wrong(judged, visible)
    singles = of(judged, *CLASS)
    detected_singles = [j for j in singles if j.detected]
    return {
        "false alarms": plain(rate(detected(healthy))),
        "healthy called unknown": plain(rate([j.outcome == "unknown" for j in healthy])),
        "faults": {name: fault_numbers(part) for name, part in fault_groups(judged).items()},
        "right class": plain(rate([j.right for j in detected_singles])),
        "interval holds": plain(rate(inside(singles))),
        "pairs both named": plain(rate([
            {f.fault_class for f in j.verdict.faults} == j.truth for j in of(judged, "pair")
            if len(j.truth) == 2])),
        "strangers": _strangers(of(judged, "stranger", "sensor")),
        "strangers wrong": plain(rate([
            j.detected or j.outcome == "healthy" for j in of(judged, "stranger", "sensor")])),
        "accuracy": plain(accuracy(judged, visible)),
        "confusion": confusion(judged, visible),
        "by condition": by_condition(judged, visible),
        "reliability": reliability(judged),
        "wrong verdicts": len(mistakes),
        "mean confidence when wrong": float(np.mean([j.confidence for j in mistakes]))
        if mistakes else None,
        "visible from": visible,
    }


def _strangers(judged: Sequence[Judged]) -> dict[str, dict[str, int]]:
    table: dict[str, Counter[str]] = {}
    for j in judged:
        table.setdefault(j.case.detail, Counter())[j.outcome] += 1
    return {name: dict(counts) for name, counts in sorted(table.items())}
