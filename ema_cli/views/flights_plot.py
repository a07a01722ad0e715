"""Plot of the flights of one actuator: severity with interval, announcements, verdicts."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ema_cli.views.record_plots import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PHASE_COLOURS,
    STYLE,
    VERMILION,
    literal,
)
from ema_prognostics.cascade.classes import LEVELS, levels_of
from ema_prognostics.trend.unit_trend import FaultTrend, UnitTrend
from ema_prognostics.words import class_name, counted, scaled
from ema_record.files import new_file

OUTCOMES = (
    ("healthy", GREEN, "o"), ("fault", VERMILION, "D"), ("unknown", ORANGE, "s"),
    ("incomplete", GREY, "x"), ("invalid", BLACK, "X"),
)
MAX_PANELS = 6
NO_PHASE = BLUE


def plot_trend(trend: UnitTrend, path: Path) -> Path:
    """Plot the flights of an actuator into a PNG that does not exist yet, and return it."""
    with mpl.rc_context(STYLE), new_file(path) as temporary:
        trend_figure(trend).savefig(temporary, format="png")
    return path


def trend_figure(trend: UnitTrend) -> Figure:
    """Return the plot of the flights of an actuator.

    One panel a class of fault: severity with its interval, first announcement (dashed),
    confirmation (solid), the flight from which it was gone (dotted), and the line of its
    growth. The lowest strip shows the verdict of every flight.
    """
    classes = list(dict.fromkeys(f.history.fault_class for f in trend.faults))[:MAX_PANELS]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 1.5 + 2.5 * max(1, len(classes))))
        axes = figure.subplots(
            len(classes) + 1, 1, sharex=True, squeeze=False,
            height_ratios=[*([3.0] * len(classes)), 1.0],
        )[:, 0]
        for panel, name in zip(axes, classes):
            _severity_panel(panel, [f for f in trend.faults if f.history.fault_class == name])
        _verdict_strip(axes[-1], trend)
        name = trend.serial_number or "unknown"
        axes[0].set_title(f"Actuator {literal(name)}: {counted(len(trend.flights))}")
        axes[-1].set_xlabel("flight")
        axes[-1].set_xlim(0.0, len(trend.flights) + 1.0)
        axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    return figure


def _severity_panel(axes: Axes, faults: list[FaultTrend]) -> None:
    name = faults[0].history.fault_class
    scale, unit = scaled(name, faults[0].history.unit)
    for fault in faults:
        history = fault.history
        colour = PHASE_COLOURS.get(history.phase or "", NO_PHASE)
        known = np.isfinite(history.severity)
        y = scale * history.severity[known]
        error = np.abs(scale * np.stack([history.lower[known], history.upper[known]]) - y)
        axes.errorbar(
            history.number[known], y, error, fmt="o", ms=3.5, lw=0.8, color=colour, alpha=0.8,
            label=class_name(name, history.phase),
        )
        for episode in fault.episodes:
            axes.axvline(episode.first, color=colour, ls="--", lw=0.9)
            if episode.confirmed is not None:
                axes.axvline(episode.confirmed, color=colour, ls="-", lw=1.2)
            if episode.cleared is not None:
                axes.axvline(episode.cleared, color=colour, ls=":", lw=1.4)
        for at in fault.falls:
            axes.axvline(at, color=colour, ls=":", lw=1.4)
        _growth_line(axes, fault, scale, colour)
    axes.set_ylim(bottom=0.0)
    top = axes.get_ylim()[1]
    for level, value in zip(("medium", "large"), levels_of(name) if name in LEVELS else ()):
        if scale * value < top:
            axes.axhline(scale * value, color=GREY, ls="-.", lw=0.7)
            axes.text(0.995, scale * value, f"{level} above", ha="right", va="bottom",
                      color=GREY, fontsize=8.0, transform=axes.get_yaxis_transform())
    for style, text in (("--", "first announced"), ("-", "confirmed"), (":", "gone or smaller")):
        axes.plot([], [], color=GREY, ls=style, label=text)
    axes.set_ylabel(f"{class_name(name)}\n({unit})")
    axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), fontsize=8.0)


def _growth_line(axes: Axes, fault: FaultTrend, scale: float, colour: str) -> None:
    rise = fault.growth
    if rise is None or not rise.growing:
        return
    known = fault.history.number[np.isfinite(fault.history.severity)]
    x = np.array([known[-rise.count], known[-1]])
    axes.plot(x, scale * (rise.severity + rise.rate * (x - x[-1])), color=colour, lw=1.6,
              alpha=0.5)


def _verdict_strip(axes: Axes, trend: UnitTrend) -> None:
    for place, (outcome, colour, marker) in enumerate(OUTCOMES):
        numbers = [f.number for f in trend.flights if f.verdict.outcome == outcome]
        axes.plot(numbers, [-place] * len(numbers), marker, color=colour, ms=4.0, ls="none")
    axes.set_yticks([-place for place in range(len(OUTCOMES))])
    axes.set_yticklabels([outcome for outcome, _, _ in OUTCOMES], fontsize=8.0)
    axes.set_ylim(-len(OUTCOMES) + 0.5, 0.5)
