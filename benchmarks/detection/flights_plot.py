"""Plot of the test bench: severity against the detectable one, and what was announced when."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.detection.flight_scores import VIEWS, Flown, Score
from ema_cli.views.record_plots import BLACK, STYLE, VERMILION
from ema_record.files import new_file

TITLES = {"fleet": "without a baseline", "baseline": "with the own baseline"}
SPAN = 10.0
"""Severities from 1 / SPAN to SPAN of the detectable one have a colour of their own."""


def plot_flights(
    units: Sequence[Flown], scores: dict[str, Score], detectable: dict[str, dict[str, float]],
    path: Path,
) -> None:
    """Plot all units, one row each, into a PNG that does not exist yet."""
    kinds = list(next(iter(detectable.values())))
    order = sorted(units, key=lambda u: (kinds.index(u.kind) if u.kind in kinds else -1, u.unit))
    with mpl.rc_context({**STYLE, "axes.grid": False}):
        figure = Figure(figsize=(11.0, 2.0 + 0.17 * len(order)))
        panels = figure.subplots(1, len(VIEWS), sharex=True, sharey=True)
        for axes, view in zip(panels, VIEWS):
            mesh = _panel(axes, order, scores[view], detectable[view], view)
        panels[0].set_yticks(range(len(order)), [_label(u) for u in order], fontsize=6.5)
        bar = figure.colorbar(mesh, ax=panels, shrink=0.6, pad=0.01)
        bar.set_ticks([-1.0, 0.0, 1.0], labels=["1/10", "1", "10"])
        bar.set_label("severity / detectable severity")
        both = [panel.get_legend_handles_labels() for panel in panels]
        unique = {label: h for handles, labels in both for h, label in zip(handles, labels)}
        figure.legend(unique.values(), unique.keys(), loc="outside lower center", ncols=5)
        content = io.BytesIO()
        figure.savefig(content, format="png")
    with new_file(path) as temporary:
        temporary.write_bytes(content.getvalue())


def _label(flown: Flown) -> str:
    name = flown.kind.replace("_", " ")
    return f"{name} {flown.detail}".strip()


def _panel(
    axes: Axes, order: Sequence[Flown], score: Score, detectable: dict[str, float], view: str
) -> mpl.collections.QuadMesh:
    flights = len(order[0].severity)
    ratio = np.full((len(order), flights), np.nan)
    for row, flown in enumerate(order):
        there = flown.severity > 0.0
        if there.any():
            ratio[row, there] = np.log10(flown.severity[there] / detectable[flown.kind])
    mesh = axes.pcolormesh(
        np.arange(1, flights + 1), np.arange(len(order)), np.ma.masked_invalid(ratio),
        cmap="PuOr_r", vmin=-np.log10(SPAN), vmax=np.log10(SPAN), shading="nearest",
    )
    rows = {flown.unit: row for row, flown in enumerate(order)}
    for name, marker, colour in (("passed", "|", BLACK), ("announced", "o", "none"),
                                 ("confirmed", "o", BLACK)):
        at = [(getattr(p, name), rows[p.unit]) for p in score.passings
              if getattr(p, name) is not None]
        if not at:
            continue
        x, y = np.array(at).T
        label = "passed the detectable severity" if name == "passed" else name
        axes.plot(x, y, marker, ms=8.0 if name == "passed" else 4.5, mfc=colour, mec=BLACK,
                  mew=1.4 if name == "passed" else 0.9, ls="none", label=label)
    false = [(n, rows[u.unit]) for u in order for n, v in enumerate(u.verdicts[view], start=1)
             if v.outcome == "fault" and u.severity[n - 1] == 0.0]
    if false:
        axes.scatter(*np.array(false).T, s=16.0, marker="x", color=VERMILION, linewidths=1.2,
                     label="false alarm")
    unsure = [(n, rows[u.unit]) for u in order for n, v in enumerate(u.verdicts[view], start=1)
              if v.outcome not in ("fault", "healthy")]
    if unsure:
        axes.scatter(*np.array(unsure).T, s=5.0, marker=".", color="#00A0A0",
                     label="no answer (unknown)")
    axes.set_title(TITLES[view])
    axes.set_xlabel("flight")
    axes.set_xlim(0.3, flights + 0.7)
    return mesh
