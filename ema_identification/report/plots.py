"""Plots of the report: panels, and the gap before and after each addition.

One look for all plots, in colours that colour-blind readers tell apart.
"""

from __future__ import annotations

import io
import textwrap
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, StrMethodFormatter

from ema_identification.report.words import data_of, number, pretty
from ema_identification.result import Curve, Identification, Panel

SIZE = (5.8, 3.5)
"""Inches: readable at half the width of a page and at the full width of a phone."""
DPI = 200
TITLE_WIDTH = 68
INK, GRID = "#1d2530", "#d9dee5"
MAX_POINTS = 20_000
"""Of a curve; longer ones are thinned, a plot has no more pixels."""
# Okabe and Ito's palette; line styles differ too, for print without colours.
ROLES: dict[str, dict[str, Any]] = {
    "measured": {"color": "#1d2530", "linewidth": 1.3, "linestyle": "-", "zorder": 3},
    "before": {"color": "#d55e00", "linewidth": 1.3, "linestyle": (0, (5, 1.5)), "zorder": 4},
    "after": {"color": "#0072b2", "linewidth": 1.5, "linestyle": (0, (1.5, 1)), "zorder": 5},
    "floor": {"color": "#8a929c", "linewidth": 1.2, "linestyle": (0, (4, 2)), "zorder": 2},
}
OTHERS = ("#009e73", "#cc79a7", "#e69f00", "#56b4e9")
MARKERS = (".", "^", "s", "x")
"""Of points, the next one where the colours begin again."""
FEW_POINTS = 500
"""Below which points are drawn large, and those that were measured as rings about the model's."""
SMALLER = 0.6
"""Of their sizes, relative to that of a point."""
HIGHER = 1.3
"""Of a figure with its legend below the axes."""
FEW = 5
"""Most entries of a legend that stands within the axes."""


def new_figure(title: str, size: tuple[float, float] = SIZE) -> tuple[Figure, Any]:
    """Return a figure and its axes, with the title as a sentence above them."""
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_title(textwrap.fill(title, TITLE_WIDTH), loc="left", fontsize=9.5, color=INK,
                   parse_math=False)
    axes.tick_params(labelsize=8.5, colors=INK, length=3)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#9aa3ad")
    axes.grid(visible=True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    return figure, axes


def to_png(figure: Figure) -> bytes:
    """Return the PNG, the same bytes for the same figure."""
    file = io.BytesIO()
    figure.savefig(file, format="png", metadata={"Software": None})
    return file.getvalue()


def draw_panel(panel: Panel) -> bytes:
    """Return the PNG of a panel."""
    many = len(panel.curves) > FEW
    figure, axes = new_figure(panel.title, (SIZE[0], SIZE[1] * HIGHER) if many else SIZE)
    others = 0
    for curve in panel.curves:
        style = dict(ROLES.get(curve.role, {}))
        if not style:
            style = {"color": OTHERS[others % len(OTHERS)], "linewidth": 1.2, "zorder": 2,
                     "marker": MARKERS[others // len(OTHERS) % len(MARKERS)]}
            others += 1
        _draw(axes, curve, style)
    axes.set_xlabel(panel.x_label, fontsize=9, color=INK, parse_math=False)
    axes.set_ylabel(panel.y_label, fontsize=9, color=INK, parse_math=False)
    if panel.log_y:
        axes.set_yscale("log")
        # Plain numbers, between decades too where the axis is short.
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.yaxis.set_minor_formatter(_Plain(minor_thresholds=(1.5, 0.5)))
        axes.yaxis.set_tick_params(which="minor", labelsize=8.5, labelcolor=INK)
    if len(panel.curves) > 1 or (panel.curves and panel.curves[0].label):
        look = {"fontsize": 8, "frameon": True, "framealpha": 0.85, "edgecolor": "none",
                "labelcolor": INK}
        legend = (figure.legend(loc="outside lower left", ncols=2, **look) if many
                  else axes.legend(**look))
        for text in legend.get_texts():
            text.set_parse_math(False)
    axes.margins(x=0.01)
    return to_png(figure)


class _Plain(LogFormatter):
    """Labels where its parent does, without powers of ten."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def _draw(axes: Any, curve: Curve, style: dict[str, Any]) -> None:
    x, y = np.asarray(curve.x, dtype=float), np.asarray(curve.y, dtype=float)
    every = max(1, -(-len(x) // MAX_POINTS))
    x, y = x[::every], y[::every]
    if curve.style == "points":
        style = {"color": style["color"], "zorder": style.get("zorder", 2), "linestyle": "none",
                 **_marker(curve.role, style.get("marker", "."), few=len(x) < FEW_POINTS)}
    else:
        style.pop("marker", None)
    axes.plot(x, y, label=curve.label or None, **style)


def _marker(role: str, marker: str, *, few: bool) -> dict[str, Any]:
    if role == "measured" and few:
        return {"marker": "o", "markersize": 7.0, "markerfacecolor": "none"}
    return {"marker": marker, "markersize": (6.0 if few else 1.5) * (
        1.0 if marker == "." else SMALLER)}


def gap_stages(identification: Identification) -> list[tuple[str, float]]:
    """Return the gap of the given model and after each effect that was added."""
    first = "model as given,\nrecalibrated" if identification.recalibrated else "model as given"
    return [(first, identification.gap_before), *(
        (f"+ {pretty(f.effect)}", f.gap_after) for f in identification.findings)]


def draw_gap(identification: Identification) -> bytes:
    """Return the PNG: one bar a stage, the noise floor as a line."""
    stages = gap_stages(identification)
    height = 1.35 + 0.42 * len(stages)
    figure, axes = new_figure(
        f"Gap between model and measurement on {data_of(identification)}, against the noise floor",
        (5.8, height))
    places = list(range(len(stages)))[::-1]
    values = [value for _, value in stages]
    colours = [ROLES["before"]["color"]] + [ROLES["after"]["color"]] * (len(stages) - 1)
    axes.barh(places, values, height=0.58, color=colours, zorder=3)
    limit = 1.16 * max(*values, identification.noise_floor, 1e-300)
    for place, value in zip(places, values):
        axes.text(value + 0.012 * limit, place, number(value), va="center", fontsize=8.5,
                  color=INK, zorder=6,
                  bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8})
    axes.axvline(identification.noise_floor, color=INK, linewidth=1.2, linestyle=(0, (4, 2)),
                 zorder=5, label=f"noise floor {number(identification.noise_floor)}")
    axes.set_yticks(places, [name for name, _ in stages], fontsize=8.5, color=INK,
                    parse_math=False)
    axes.set_xlim(0.0, limit)
    axes.set_xlabel(identification.gap_unit, fontsize=8.5, color=INK, parse_math=False, wrap=True)
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.legend(fontsize=8, loc="lower right", frameon=True, framealpha=0.85, edgecolor="none")
    return to_png(figure)
