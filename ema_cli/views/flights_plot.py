"""Plot of the flights of one actuator: severities, announcements, verdicts, and what is ahead."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from ema_cli.views.record_plots import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    PHASE_COLOURS,
    STYLE,
    VERMILION,
    literal,
)
from ema_prognostics.cascade.classes import LEVELS, levels_of
from ema_prognostics.trend.flights import Flight, date_of
from ema_prognostics.trend.forecast import Outlook, course
from ema_prognostics.trend.growth import Growth
from ema_prognostics.trend.unit_trend import LIMIT, FaultTrend, UnitTrend
from ema_prognostics.words import class_name, scaled, words
from ema_record.errors import counted

SKY = "#56B4E9"
OUTCOMES = (
    ("healthy", SKY, "o"), ("fault", VERMILION, "D"), ("unknown", ORANGE, "s"),
    ("incomplete", GREY, "x"), ("invalid", BLACK, "X"),
)
MAX_PANELS = 6
NO_PHASE = BLUE
LONGEST_AHEAD = 3.0
"""Of the flights that there are, drawn ahead at most."""
FEWEST_AHEAD = 5
TOP = 1.25
"""Top of an axis, of the largest size that is measured or expected on it."""


def trend_figure(trend: UnitTrend) -> Figure:
    """Return the plot of the flights of an actuator.

    One panel a class of fault: severity with its interval, first announcement (dashed),
    confirmation (solid), the flight from which it was gone (dotted), the line of its growth, and
    ahead of the last flight its 90 % cone, with the flights at which each level is reached. The
    lowest strip shows the verdict of every flight.
    """
    classes = list(dict.fromkeys(f.history.fault_class for f in trend.faults))[:MAX_PANELS]
    end = _end(trend)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 1.7 + 2.7 * max(1, len(classes))))
        axes = figure.subplots(
            len(classes) + 1, 1, sharex=True, squeeze=False,
            height_ratios=[*([3.0] * len(classes)), 1.0],
        )[:, 0]
        for panel, name in zip(axes, classes):
            _severity_panel(
                panel, [f for f in trend.faults if f.history.fault_class == name], end)
        _verdict_strip(axes[-1], trend)
        name = trend.serial_number or "unknown"
        axes[0].set_title(f"Actuator {literal(name)}: {counted(len(trend.flights), 'flight')}")
        axes[-1].set_xlim(0.0, end + 1.0)
        _dates(axes[-1], trend.flights)
    return figure


def _end(trend: UnitTrend) -> float:
    """Return the last flight that is drawn: far enough to show what is expected next."""
    last = float(len(trend.flights))
    ahead = [float(f.interval[1] or f.flight or f.interval[0]) for fault in trend.faults
             for f in fault.forecasts]
    most = last + max(FEWEST_AHEAD, LONGEST_AHEAD * last)
    return min(most, max([last, *(1.05 * a for a in ahead)]))


def _dates(axes: Axes, flights: Sequence[Flight]) -> None:
    """Name the flights on the axis, with their dates where they are known; ahead with a ~."""
    last = len(flights)

    def name(value: float, _place: int | None = None) -> str:
        number = round(value)
        if number < 1 or abs(value - number) > 1e-6:
            return ""
        date = date_of(flights, number)
        mark = "~" if number > last else ""
        return f"{number}" + ("" if date is None else f"\n{mark}{date:%Y-%m-%d}")

    axes.xaxis.set_major_locator(MaxNLocator(nbins=7, integer=True, min_n_ticks=1))
    axes.xaxis.set_major_formatter(FuncFormatter(name))
    axes.tick_params(axis="x", labelsize=8.0)
    dated = any(f.start_time for f in flights)
    say = words()
    axes.set_xlabel(say("plot.flight") + (f", {say('plot.date')}" if dated else ""))


def _severity_panel(axes: Axes, faults: list[FaultTrend], end: float) -> None:
    say = words()
    name = faults[0].history.fault_class
    scale, unit = scaled(name, faults[0].history.unit)
    for fault in faults:
        history = fault.history
        colour = PHASE_COLOURS.get(history.phase or "", NO_PHASE)
        known = np.isfinite(history.severity)
        y = scale * history.severity[known]
        error = np.abs(scale * np.stack([history.lower[known], history.upper[known]]) - y)
        axes.errorbar(
            history.number[known], y, error, fmt="o", ms=3.5, lw=0.8, color=colour, zorder=3,
            label=class_name(name, history.phase),
        )
        for episode in fault.episodes:
            axes.axvline(episode.first, color=GREY, ls="--", lw=0.9, zorder=1)
            if episode.confirmed is not None:
                axes.axvline(episode.confirmed + 0.08, color=GREY, ls="-", lw=0.9, zorder=1)
            if episode.cleared is not None:
                axes.axvline(episode.cleared, color=GREY, ls=":", lw=1.4, zorder=1)
        for at in fault.falls:
            axes.axvline(at, color=GREY, ls=":", lw=1.4, zorder=1)
        if fault.growth is not None and fault.outlook is not None:
            _cone(axes, fault, fault.growth, fault.outlook, scale, colour, end)
    axes.set_ylim(0.0, min(axes.get_ylim()[1], _room(faults, scale, end)))
    _level_lines(axes, faults, scale, end)
    for style, text in (("--", "first announced"), ("-", "confirmed"), (":", "gone or smaller")):
        axes.plot([], [], color=GREY, ls=style, label=text)
    axes.set_ylabel(f"{class_name(name)}\n({unit})")
    axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), fontsize=8.0,
                title=say("label.trend"), title_fontsize=8.0)


def _room(faults: list[FaultTrend], scale: float, end: float) -> float:
    """Return the top of the axis: what was measured and is expected; a wide cone is cut."""
    most = [float(np.nanmax(part)) for fault in faults
            for part in (fault.history.severity, fault.history.upper) if np.isfinite(part).any()]
    for fault in faults:
        if fault.outlook is not None:
            ahead = np.array([0.0, max(0.0, end - len(fault.history.number))])
            most.append(float(course(fault.outlook, ahead)[0][-1]))
        most += [f.severity for f in fault.forecasts
                 if f.flight is not None and f.interval[0] <= end]
    return TOP * scale * max(most, default=np.inf)


def _level_lines(axes: Axes, faults: list[FaultTrend], scale: float, end: float) -> None:
    """Draw the levels that are in sight, and the flights at which each is expected."""
    say = words()
    name = faults[0].history.fault_class
    top = axes.get_ylim()[1]
    levels = dict(zip(("medium", "large"), levels_of(name) if name in LEVELS else ()))
    own = [f.severity for one in faults for f in one.forecasts if f.level == LIMIT]
    levels |= dict.fromkeys((LIMIT,) if own else (), max(own, default=0.0))
    for level, value in levels.items():
        if scale * value < 1.15 * top:
            axes.axhline(scale * value, color=GREY, ls="-.", lw=0.7)
            text = say("plot.limit") if level == LIMIT else say(f"level.{level}")
            axes.text(0.004, scale * value, text, ha="left", va="bottom", color=GREY,
                      fontsize=8.0, transform=axes.get_yaxis_transform())
    for fault in faults:
        for ahead in fault.forecasts:
            if ahead.flight is None or scale * ahead.severity > 1.15 * top:
                continue
            first, last = ahead.interval
            axes.plot([first, last or 2.0 * ahead.flight], [scale * ahead.severity] * 2,
                      color=BLACK, lw=2.2, solid_capstyle="butt", zorder=4)
            beyond = ahead.flight > end + 1.0  # right of what is drawn: said at the edge
            at = end + 1.0 if beyond else float(ahead.flight)
            axes.plot(at, scale * ahead.severity, ">" if beyond else "D", color=BLACK, ms=5.0,
                      zorder=5, clip_on=False)
            axes.annotate(f"{ahead.flight} ({first}–{last or '…'})",
                          (at, scale * ahead.severity), (0, 5), textcoords="offset points",
                          ha="right" if beyond else "center", va="bottom", fontsize=8.0)


def _cone(
    axes: Axes, fault: FaultTrend, rise: Growth, outlook: Outlook, scale: float, colour: str,
    end: float,
) -> None:
    known = fault.history.number[np.isfinite(fault.history.severity)]
    begin, now = float(known[-rise.count]), float(known[-1])
    x = np.array([begin, now])
    axes.plot(x, scale * (rise.severity + rise.rate * (x - now)), color=colour, lw=1.6, alpha=0.5)
    ahead = np.linspace(0.0, max(0.0, end - now), 60)
    middle, low, high = (scale * part for part in course(outlook, ahead))
    axes.fill_between(now + ahead, np.maximum(low, 0.0), high, color=colour, alpha=0.15, lw=0.0,
                      label="90 %")
    axes.plot(now + ahead, middle, color=colour, lw=1.4, ls=(0, (5, 2)), label="expected")


def _verdict_strip(axes: Axes, trend: UnitTrend) -> None:
    say = words()
    for place, (outcome, colour, marker) in enumerate(OUTCOMES):
        numbers = [f.number for f in trend.flights if f.verdict.outcome == outcome]
        axes.plot(numbers, [-place] * len(numbers), marker, color=colour, ms=4.0, ls="none")
    axes.set_yticks([-place for place in range(len(OUTCOMES))])
    axes.set_yticklabels([say(f"outcome.{outcome}").lower() for outcome, _, _ in OUTCOMES],
                         fontsize=8.0)
    axes.set_ylim(-len(OUTCOMES) + 0.5, 0.5)
