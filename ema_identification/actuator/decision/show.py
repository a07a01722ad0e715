"""What the decision did, for people: the steps in order, and two pictures as data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.decision.decide import FleetAnswer, log_evidence
from ema_identification.actuator.decision.fit import LawFit, TestedUnit
from ema_identification.actuator.decision.fleet import NAMES
from ema_identification.actuator.decision.gap import LawGap
from ema_identification.actuator.panels import by_place
from ema_identification.actuator.words import ResidualGroup, where_step
from ema_identification.result import Curve, Panel, Step

SHOWN = 8
"""Rows of a table."""


def steps_of(
    unit: TestedUnit, answer: FleetAnswer, groups: Sequence[ResidualGroup], gap: LawGap
) -> tuple[Step, ...]:
    """Return the steps of a decision in order."""
    c, fit = unit.conditions, answer.null if answer.fit is None else answer.fit
    moved = sorted(zip(NAMES, fit.z - unit.centre), key=lambda x: -abs(x[1]))[:SHOWN]
    steps = [
        Step(name="align", text=(
            f"Read off the record: winding {c.temperature:.0f} degC, bus {100.0 * c.bus:+.1f} %, "
            f"noise of the sensors {c.noise:.2f} of the usual, rotor {c.start_angle:.2f} rad.")),
        Step(name="recalibrate", text=(
            "All that healthy units differ in, fitted within its band; those that moved most, in "
            "half widths."), rows=(("parameter", "half widths"), *(
                (name, f"{x:+.2f}") for name, x in moved))),
        where_step(groups),
        Step(name="name", text=_verdict_text(unit, answer), rows=(
            ("model", "left a feature", "log evidence"), *(
                (", ".join(t.variant.name for t in f.terms), f"{f.cost / unit.size:.2f}",
                 f"{_beside(answer, f, unit.library.freedom):+.1f}")
                for f in answer.fits[:SHOWN]))),
        Step(name="show", text=(
            f"The gap on {'the held-out' if answer.gap is not None else 'the fitted'} record: "
            + ", then ".join(f"{x:.3g}" for x in gap.values)
            + f"; half of the healthy units leave {gap.floor:.3g} or less, 95 % up to "
              f"{gap.bound:.3g}.")),
    ]
    return tuple(steps)


def _verdict_text(unit: TestedUnit, answer: FleetAnswer) -> str:
    """Return what the test for nothing said."""
    said = (f"Without a law {answer.null.cost / unit.size:.2f} is left a feature; of healthy "
            f"units, up to {answer.p_nothing:.2g} are as far off.")
    return said if not answer.fits else (
        f"{said} Laws fitted with the simulator, most evidence first.")


def _beside(answer: FleetAnswer, fit: LawFit, freedom: float) -> float:
    """Return the log evidence beside the best one."""
    best = max(log_evidence(f, freedom) for f in answer.fits)
    return log_evidence(fit, freedom) - best


def panels_of(unit: TestedUnit, answer: FleetAnswer) -> tuple[Panel, ...]:
    """Return the residual of each part of the test, and what each candidate leaves."""
    rows = [("model before", "before", answer.null)]
    if answer.fit is not None:
        rows.append(("model after", "after", answer.fit))
    curves = []
    for label, role, fit in rows:
        rest = (unit.values - fit.mean) / np.sqrt(np.diag(unit.covariance(fit.runs)))
        x, y = by_place(unit.library.fmap, rest)
        curves.append(Curve(label=label, x=x, y=y, role=role,  # type: ignore[arg-type]
                            style="points"))
    floor = Curve(label="nothing missing", x=x, y=np.ones_like(x), role="floor")
    found = [Panel(
        name="where", title="Residual of each part of the test, before and after.",
        x_label="time of the test (s)", y_label="residual, rms (standard deviations)",
        curves=(*curves, floor), step="where", log_y=True)]
    if answer.fits:
        costs = np.sqrt([f.cost / unit.size for f in answer.fits])
        place = np.arange(1.0, len(costs) + 1.0)
        found.append(Panel(
            name="candidates", title="What each candidate leaves, most evidence first.",
            x_label="candidate", y_label="misfit (standard deviations)", step="name",
            curves=(*(Curve(label=", ".join(t.variant.name for t in f.terms),
                            x=place[k:k + 1], y=costs[k:k + 1], style="points")
                      for k, f in enumerate(answer.fits)),
                    Curve(label="model before", x=place, role="before", y=np.full_like(
                        place, np.sqrt(answer.null.cost / unit.size))))))
    return tuple(found)
