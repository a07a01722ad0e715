"""The picture of a verdict: each reason beside healthy units, torque ripple, currents, the test.

The healthy shadow of the currents is that of simulated units of the type, drawn within its
tolerances; of the ripple and of the reasons that of the fleet that the networks were trained on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from ema_cli.views.phases import phases_of
from ema_cli.views.record_plots import (
    BLACK,
    BLUE,
    FOLD_BINS,
    GREY,
    ORANGE,
    PHASE_COLOURS,
    STYLE,
    VERMILION,
    completed_record,
    literal,
)
from ema_cli.views.verdict import fault_size, short, times_text, title
from ema_prognostics.features.balance import HARMONICS
from ema_prognostics.features.extract import extract
from ema_prognostics.features.profile_kind import ProfileKind, profile_kind
from ema_prognostics.features.turns import whole_turns
from ema_prognostics.paper.features import fold
from ema_prognostics.words import feature_words, words
from ema_record.actuator import load_actuator
from ema_record.channels import PHASE_CURRENTS
from ema_record.errors import RecordError
from ema_record.profiles.plan import test_plan
from ema_record.record import Record

if TYPE_CHECKING:
    from ema_prognostics.cascade.find import Cascade
    from ema_prognostics.verdict.examination import Examination

SHADOW = "#C9D3DF"
OWN = "#8FC1E6"
UNITS = 8
"""Healthy units that are simulated for the shadow of the currents."""
SEED = 20_261
RAYLEIGH = 2.146
"""Spreads of one component below which 90 % of the lengths of a healthy line lie."""


def evidence_figure(found: Examination, cascade: Cascade | None) -> Figure:
    """Return the picture of the verdict on a record.

    Parameters
    ----------
    found : with a record.
    cascade : that of the type for the record's test, None where it is not known.
    """
    assert found.record is not None
    record, _ = completed_record(found.record)
    verdict = found.verdict.to_dict()
    kind = profile_kind(record.profile)
    rows = [e for e in verdict["evidence"] if e["value"] is not None]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.5, 7.4 + 0.35 * len(rows)), layout="constrained")
        parts: Any = figure.subfigures(
            3, 1, height_ratios=[0.9 + 0.42 * len(rows), 3.6, 2.1])
        top, middle, bottom = parts
        figure.suptitle(literal(_title(found, verdict)), fontsize=11.5, x=0.01, ha="left")
        _reasons(top, rows)
        left, right = middle.subfigures(1, 2, width_ratios=[2.0, 3.0])
        if kind is not None:
            _ripple(left, record, kind, cascade)
            _currents(right, record, kind)
        _course(bottom.subplots(), record)
    return figure


def _title(found: Examination, verdict: dict[str, Any]) -> str:
    say = words()
    faults = "; ".join(f"{title(f)} {fault_size(f)}".rstrip() for f in verdict["faults"])
    time = found.heading()["start_time"][:16].replace("T", " ")
    head = [say(f"outcome.{verdict['verdict']}"), found.serial_number, time, faults]
    return "   ".join(filter(None, head))


def _reasons(figure: SubFigure, rows: list[dict[str, Any]]) -> None:
    """Draw a line for each reason: the value, 90 % of healthy units, the own baseline."""
    say = words()
    panels = np.atleast_1d(figure.subplots(max(1, len(rows)), 1))
    for axes in panels:
        axes.grid(visible=False)
        axes.set_yticks([])
        for side in ("left", "bottom"):
            axes.spines[side].set_visible(False)
        axes.tick_params(bottom=False, labelsize=8.0, pad=0.0)
    for axes, row in zip(panels, rows):
        for key, colour, half in (("healthy", SHADOW, 0.9), ("own", OWN, 0.45)):
            if row[key]:
                axes.barh(0.0, row[key][1] - row[key][0], left=row[key][0], height=half,
                          color=colour, zorder=1)
        axes.axhline(0.0, color=GREY, lw=0.7, zorder=0)
        axes.plot(row["value"], 0.0, "D", color=VERMILION, ms=7.0, zorder=3)
        ends = [row["value"], *row["healthy"], *(row["own"] or ())]
        margin = 0.07 * (max(ends) - min(ends) or 1.0)
        axes.set(xlim=(min(ends) - margin, max(ends) + margin), ylim=(-0.65, 0.65))
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.set_ylabel(f"{feature_words(row['feature'])}\n{short(row['value'])} {row['unit']}",
                        rotation=0, ha="right", va="center", fontsize=9.0)
        axes.text(1.01, 0.5, times_text(row["times"]), transform=axes.transAxes, va="center",
                  fontsize=10.0, fontweight="bold")
    marks = [panels[0].barh(9.0, 0.0, color=SHADOW, label=say("report.healthy_band")),
             panels[0].plot([], [], "D", color=VERMILION, label=say("report.measured"))[0]]
    if any(row["own"] for row in rows):
        marks.insert(1, panels[0].barh(9.0, 0.0, color=OWN, label=say("report.own_band")))
    if not rows:
        panels[0].set_xticks([])
        return
    figure.legend(handles=marks, loc="outside lower center", ncols=3, fontsize=8.5)


def _ripple(
    figure: SubFigure, record: Record, kind: ProfileKind, cascade: Cascade | None
) -> None:
    """Draw the lines of the torque at multiples of the rotor angle, beside healthy units'."""
    say = words()
    try:
        features = extract(record, kind)
    except RecordError:
        return
    speeds = [s for s in ("quarter", "full") if f"{s}_even_m1_re" in features]
    panels = np.atleast_1d(figure.subplots(len(speeds), 1, sharex=True))
    order = np.arange(1, HARMONICS + 1)
    for axes, speed in zip(panels, speeds):
        stems = [f"{speed}_even_m{h}" for h in order]
        size = [0.1 * float(np.hypot(features[f"{s}_re"], features[f"{s}_im"])) for s in stems]
        if cascade is not None:
            names = cascade.inputs.input_names
            usual = [0.1 * (_length(cascade.inputs.center, names, s)
                            + RAYLEIGH * _length(cascade.inputs.spread, names, s) / np.sqrt(2.0))
                     for s in stems]
            axes.bar(order, usual, width=0.9, color=SHADOW, label=say("report.healthy_band"))
        axes.vlines(order, 0.0, size, color=VERMILION, lw=2.5, label=say("report.measured"))
        axes.plot(order, size, "D", color=VERMILION, ms=5.0)
        axes.set_title(say(f"phases.{speed}"), fontsize=9.0, loc="right")
        axes.set_ylim(bottom=0.0)
        axes.set_xticks(order)
    panels[-1].set_xlabel(say("plot.per_turn"))
    figure.supylabel(say("plot.ripple"), fontsize=9.5)


def _length(values: np.ndarray, names: list[str], stem: str) -> float:
    return float(np.hypot(*(values[names.index(f"{stem}_{part}")] for part in ("re", "im"))))


def _currents(figure: SubFigure, record: Record, kind: ProfileKind) -> None:
    """Draw the currents over a turn of the rotor, with those of healthy units behind."""
    say = words()
    panels = figure.subplots(3, 1, sharex=True, sharey=True)
    bins = (np.arange(FOLD_BINS) + 0.5) * (360.0 / FOLD_BINS)
    try:
        own = folded(record, kind)
    except RecordError:
        return
    shadow = healthy_currents(record, kind)
    for k, (axes, phase) in enumerate(zip(panels, "abc")):
        if len(shadow):
            axes.fill_between(bins, shadow[:, k].min(axis=0), shadow[:, k].max(axis=0),
                              color=SHADOW, lw=0.0, label=say("plot.simulated", count=len(shadow)))
        axes.plot(bins, own[k], color=PHASE_COLOURS[phase], lw=1.4, label=say("report.measured"))
        axes.set_ylabel(f"{phase} (A)")
    panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, fontsize=8.0)
    slow = kind == "extended"
    panels[0].set_title(say("phases.quarter" if slow else "phases.full"), fontsize=9.0, loc="left")
    panels[-1].set(xlabel=say("plot.angle"), xlim=(0.0, 360.0))
    panels[-1].set_xticks(np.arange(0, 361, 60))


def folded(record: Record, kind: ProfileKind) -> np.ndarray:
    """Return the phase currents over a turn, shape (3, FOLD_BINS) (A): of the slow slew if any."""
    actuator = load_actuator()
    plan = test_plan(record.profile, actuator)
    part = plan.quarter if kind == "extended" and plan.quarter is not None else plan.full
    start = record.profile.command_time
    turns = whole_turns(record, (start + part.begin, start + part.end),
                        pole_pairs=actuator.motor.pole_pairs)
    currents = turns.samples[:, PHASE_CURRENTS]
    return np.array([fold(turns, currents[:, k], FOLD_BINS) for k in range(3)])


def healthy_currents(record: Record, kind: ProfileKind) -> np.ndarray:
    """Return `folded` of `UNITS` simulated healthy units, shape (n, 3, FOLD_BINS) (A)."""
    from ema_prognostics.training.conditions import (
        actuator_of,
        draw_conditions,
        draw_unit,
        effects_of,
    )
    from ema_prognostics.training.faults import HEALTHY
    from ema_record.spread import load_spread
    from ema_sim.simulate import simulate

    rng, spread, nominal = np.random.default_rng(SEED), load_spread(), load_actuator()
    found = []
    for _ in range(UNITS):
        unit, conditions = draw_unit(rng, spread.tolerances), draw_conditions(
            rng, spread.conditions)
        try:
            made = simulate(record.profile, actuator=actuator_of(nominal, unit, conditions),
                            seed=conditions.seed,
                            effects=effects_of(nominal, unit, conditions, HEALTHY))
            found.append(folded(made, kind))
        except RecordError:
            continue
    return np.array(found)


def _course(axes: Axes, record: Record) -> None:
    """Draw speed and position over the test, its phases shaded and named."""
    say = words()
    for begin, end, name in phases_of(record.profile):
        axes.axvspan(begin, end, color=ORANGE, alpha=0.13, lw=0.0)
        axes.text(0.5 * (begin + end), 1.01, name, ha="center", va="bottom", fontsize=8.0,
                  color=GREY, transform=axes.get_xaxis_transform())
    axes.plot(record.time, record.channel("motor_speed"), color=BLUE, lw=0.7)
    axes.set(xlabel=say("plot.time"), xlim=(float(record.time[0]), float(record.time[-1])))
    axes.set_ylabel(say("plot.speed"), color=BLUE)
    other = axes.twinx()
    other.plot(record.time, record.channel("surface_position"), color=BLACK, lw=1.2)
    other.set_ylabel(say("plot.position"))
    other.grid(visible=False)
    other.spines["right"].set_visible(True)
