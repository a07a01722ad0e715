"""Where a fit leaves something: residuals by signal and part of the test."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.laws.terms import LawFit
from ema_identification.result import Step, Where

SHOWN = 8
"""Rows of the table."""


class ResidualGroup(NamedTuple):
    """Residuals of one signal in one part of the test."""

    excess: float
    """Sum of log(1 + r²), less what noise gives."""
    signal: str
    against: str
    place: str
    largest: float
    """Standard deviations."""
    rms: float


def groups_of(unit: TestedUnit, residual: np.ndarray) -> list[ResidualGroup]:
    """Return residuals (standard deviations) by signal, abscissa and place, most excess first."""
    found: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    for part, r in zip(unit.parts, unit.split(residual)):
        plan = part.library.fmap.plan
        texts = {s.name: s.text for s in plan.segments}
        texts |= {t.name: t.text for t in plan.transitions}
        for feature, x in zip(part.library.fmap.features, r):
            place = texts.get(feature.place, "whole record")
            found[feature.signal, feature.against, place].append(float(x))
    groups = []
    for (signal, against, place), items in found.items():
        values = np.array(items)
        groups.append(ResidualGroup(
            float(np.log1p(values**2).sum() - 0.55 * len(values)), signal, against, place,
            float(np.abs(values).max()), float(np.sqrt(np.mean(values**2)))))
    return sorted(groups, reverse=True)


def where_of(groups: Sequence[ResidualGroup]) -> Where:
    """Return the place of the largest disagreement."""
    g = groups[0]
    return Where(signal=g.signal, against=g.against, text=(
        f"{g.signal} against {g.against}, {g.place}: {g.rms:.1f} standard deviations rms, "
        f"{g.largest:.1f} at most"))


def where_step(groups: Sequence[ResidualGroup]) -> Step:
    """Return the table of the step."""
    rows = [("signal", "against", "part of the test", "rms", "largest")]
    rows += [(g.signal, g.against, g.place, f"{g.rms:.1f}", f"{g.largest:.1f}")
             for g in groups[:SHOWN]]
    return Step(
        name="where", rows=tuple(rows),
        text="Residuals of the recalibrated model by signal and part of the test, in standard "
             "deviations of what it may be off when nothing is missing. The first row is the one "
             "where most of its features disagree; a single huge value, as a limit cycle out of "
             "phase gives, counts by its logarithm only.")


def residual_of(unit: TestedUnit, fit: LawFit) -> np.ndarray:
    """Return what a fit leaves, in standard deviations of the right model, shape (d,)."""
    return np.asarray((unit.values - fit.mean) / np.sqrt(np.diag(unit.covariance(fit.runs))))
