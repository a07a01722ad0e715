"""Plots as data: measured against the model before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.decision.answer import FleetAnswer
from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.fleet.units import fleet_record
from ema_identification.actuator.laws.terms import LawFit, LawGap, with_terms
from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.lines import turns_of
from ema_identification.actuator.measure.signals import DriveSignals, drive_signals
from ema_identification.actuator.residuals import residual_of
from ema_identification.result import Curve, Panel
from ema_record.errors import InvalidRecordError, SimulationError
from ema_record.record import Record
from ema_sim.machine import TURN

BINS = 90
POINTS = 500
DECADE = 10.0
"""Ratio from which an axis is logarithmic."""
SMOOTH = 5e-3
"""Moving mean of plotted curves (s)."""


def panels_of(
    unit: TestedUnit, answer: FleetAnswer, held: TestedUnit | None, gap: LawGap
) -> tuple[Panel, ...]:
    """Return the plots of an identification, of its first record."""
    first = unit.parts[0]
    fits = [("before", answer.null)]
    if answer.fit is not None:
        fits.append(("after", answer.fit))
    panels = [_by_part(unit, [(role, residual_of(unit, fit)) for role, fit in fits], "where",
                       "Residual of each part of the test, before and after.", "where"),
              *_vectors(unit, fits)]
    runs = [(role, record_of(first, fit)) for role, fit in fits]
    signals = [(role, drive_signals(record, first.library.model.actuator))
               for role, record in [("measured", first.record), *runs] if record is not None]
    panels += [_travel(signals), *_folded(first, signals)]
    if finite := [f for f in answer.fits if np.isfinite(f.cost)]:
        panels.append(_candidates(unit, answer.null, finite))
    panels.append(_by_part(
        unit if held is None else held,
        [("before", gap.rest[0]), *(("after", rest) for rest in gap.rest[1:][-1:])], "gap_by_part",
        f"The gap on the {'fitted' if held is None else 'held-out'} record, by part of the test.",
        "show"))
    return tuple(panels)


def record_of(unit: TestedUnit, fit: LawFit) -> Record | None:
    """Return a run of a fitted model; None outside the simulator's domain."""
    library = unit.library
    try:
        return fleet_record(library.model, library.spread, library.fmap, fit.z[:library.width],
                            unit.conditions, unit.seed + 7,
                            with_terms(fit.terms, library.model.effects))
    except (SimulationError, InvalidRecordError):
        return None


def _role_curves(
    rows: Sequence[tuple[str, np.ndarray, np.ndarray]], style: str = "line"
) -> tuple[Curve, ...]:
    labels = {"measured": "measured", "before": "model before", "after": "model after"}
    return tuple(
        Curve(label=labels[role], x=x, y=y, role=role, style=style)  # type: ignore[arg-type]
        for role, x, y in rows
    )


def by_place(fmap: FeatureMap, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return time (s) and rms residual of each part of a record."""
    plan = fmap.plan
    times = {s.name: 0.5 * (s.begin + s.end) for s in plan.segments}
    times |= {t.name: t.time for t in plan.transitions} | {"record": 0.0}
    places = np.array([f.place for f in fmap.features])
    names = sorted(set(places), key=lambda n: times[n])
    return (np.array([times[n] for n in names]),
            np.array([np.sqrt(np.mean(residual[places == n]**2)) for n in names]))


def _by_part(
    unit: TestedUnit, rests: Sequence[tuple[str, np.ndarray]], name: str, title: str, step: str
) -> Panel:
    """Return residuals (standard deviations) by part of the first record, beside a floor of 1."""
    fmap = unit.parts[0].library.fmap
    rows = [(role, *by_place(fmap, unit.split(rest)[0])) for role, rest in rests]
    x = rows[0][1]
    floor = Curve(label="nothing missing", x=x, y=np.ones_like(x), role="floor")
    return Panel(
        name=name, title=title, x_label="time of the test (s)",
        y_label="residual, rms (standard deviations)",
        curves=(*_role_curves(rows, "points"), floor), step=step, log_y=True)


def _vectors(unit: TestedUnit, fits: Sequence[tuple[str, LawFit]]) -> list[Panel]:
    """Return torque against speed and torque lines, from the features."""
    first = unit.parts[0]
    fmap, plan = first.library.fmap, first.library.fmap.plan
    index = {f.name: k for k, f in enumerate(fmap.features)}
    vectors = [("measured", first.values), *((role, unit.split(f.mean)[0]) for role, f in fits)]
    left = unit.split(residual_of(unit, fits[0][1]))[0]
    k2 = 2.0 * first.library.model.actuator.motor.back_emf_constant
    moving = [s for s in plan.segments if s.kind != "hold"]
    panels = []
    if moving:
        x = np.array([s.speed for s in moving])
        panels.append(Panel(
            name="torque_speed", title="Mean motor torque of each slew and ramp, against speed.",
            x_label="motor speed (rad/s)", y_label="motor torque (N m)", step="where",
            curves=_role_curves([(role, x, k2 * np.array(
                [v[index[f"{s.name}.current"]] for s in moving])) for role, v in vectors],
                "points")))
    locked = [s for s in moving if f"{s.name}.torque_line_24_re" in index] or [
        s for s in moving if f"{s.name}.torque_line_1_re" in index]
    if locked:
        segment = max(locked, key=lambda s: _line_power(fmap, left, s.name))
        orders = [h for h in range(1, 25) if f"{segment.name}.torque_line_{h}_re" in index]
        stem = f"{segment.name}.torque_line"
        rows = [(role, np.array(orders, dtype=float), np.array([
            2e-3 * np.hypot(v[index[f"{stem}_{h}_re"]], v[index[f"{stem}_{h}_im"]])
            for h in orders])) for role, v in vectors]
        panels.append(Panel(
            name="torque_lines", title=f"Torque periodic in rotor angle: {segment.text}.",
            x_label="periods a turn", y_label="amplitude (N m)", step="where",
            curves=_role_curves(rows, "points"), log_y=True))
    return panels


def _line_power(fmap: FeatureMap, residual: np.ndarray, place: str) -> float:
    return float(sum(x**2 for f, x in zip(fmap.features, residual)
                     if f.place == place and ".torque_line_" in f.name))


def _thin(values: np.ndarray, width: int) -> np.ndarray:
    smooth = np.convolve(values, np.ones(width) / width, mode="same")
    return smooth[::max(1, len(values) // POINTS)]


def _travel(signals: Sequence[tuple[str, DriveSignals]]) -> Panel:
    rows = []
    for role, s in signals:
        width = max(1, round(SMOOTH / max(float(np.median(np.diff(s.time))), 1e-9)))
        rows.append((role, _thin(s.time, 1), 1e3 * _thin(s.lag, width)))
    return Panel(
        name="lag", title="Motor travel through the gear minus surface position, over the test.",
        x_label="time (s)", y_label="lag (mrad)", curves=_role_curves(rows), step="where")


def _folded(unit: TestedUnit, signals: Sequence[tuple[str, DriveSignals]]) -> list[Panel]:
    """Return the torque current over a turn of the rotor, of a slow and a fast segment."""
    plan = unit.library.fmap.plan
    slews = [s for s in plan.segments if s.kind == "slew"]
    if not slews:
        return []
    panels = []
    chosen = {min(slews, key=lambda s: abs(s.speed)).name: "slow",
              max(slews, key=lambda s: abs(s.speed)).name: "fast"}
    for segment in [s for s in slews if s.name in chosen]:
        rows = []
        for role, s in signals:
            turns = turns_of(s.theta, s.between(segment.begin, segment.end))
            if turns is None:
                continue
            place = (np.mod(turns.theta, TURN) / TURN * BINS).astype(int) % BINS
            count = np.maximum(np.bincount(place, minlength=BINS), 1)
            mean = np.bincount(place, weights=s.torque_current[turns.part], minlength=BINS) / count
            rows.append((role, 360.0 / BINS * (np.arange(BINS) + 0.5), mean))
        panels.append(Panel(
            name=f"current_{chosen[segment.name]}",
            title=f"Torque current over a turn of the rotor: {segment.text}.",
            x_label="electrical rotor angle (deg)", y_label="torque current (A)",
            curves=_role_curves(rows), step="where"))
    return panels


def _candidates(unit: TestedUnit, null: LawFit, fits: Sequence[LawFit]) -> Panel:
    costs = np.array([np.sqrt(f.cost / unit.size) for f in fits])
    x = np.arange(1.0, len(costs) + 1.0)
    curves = [
        Curve(label=", ".join(t.variant.name for t in f.terms), x=x[k:k + 1], y=costs[k:k + 1],
              style="points")
        for k, f in enumerate(fits)
    ]
    ends = np.array([0.5, len(costs) + 0.5])
    usual = np.sqrt(np.median(unit.library.healthy[:, 0]))
    curves += [
        Curve(label="model before", x=ends, role="before",
              y=np.full(2, np.sqrt(null.cost / unit.size))),
        Curve(label="nothing missing", x=ends, y=np.full(2, usual), role="floor"),
    ]
    return Panel(name="candidates", title="What each candidate leaves, most evidence first.",
                 x_label="candidate", y_label="misfit (standard deviations)",
                 curves=tuple(curves), step="name",
                 log_y=bool(costs.max() > DECADE * costs.min()))
