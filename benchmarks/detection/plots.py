"""Plots of the detection benchmark: detection curves, and the reliability diagram."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.detection.judge import CLASS, Judged, View, detected, of, severities
from ema_prognostics.training.rates import rate

UNITS = {
    "turn_short": (100.0, "% of the turns"), "rotor_eccentricity": (100.0, "% of the air gap"),
    "static_eccentricity": (100.0, "% of the air gap"), "motor_friction": (100.0, "% increase"),
    "surface_friction": (100.0, "% increase"), "backlash": (1e3, "mrad at the surface"),
}
COLOURS = {"fleet": "#0072b2", "baseline": "#d55e00"}
NAMES = {"fleet": "fleet model only", "baseline": "own baseline"}
GROUPS = 8
"""Points of the observed rate."""


def plot_detection(
    results: Mapping[View, Sequence[Judged]], numbers: Mapping[View, dict[str, Any]], path: Path
) -> None:
    """Draw the probability of detection against severity, of each fault and view."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 7), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    for axis, group in zip(axes, CLASS):
        scale, unit = UNITS[group]
        for view, judged in results.items():
            part = of(judged, group)
            x, found = severities(part), detected(part)
            order = np.argsort(x)
            for rows in np.array_split(order, GROUPS):
                r = rate(found[rows])
                at = scale * float(np.exp(np.log(x[rows]).mean()))
                axis.plot([at, at], [r.lower, r.upper], color=COLOURS[view], alpha=0.4)
                axis.plot(at, r.value, "o", color=COLOURS[view], markersize=4)
            entry = numbers[view]["faults"][group]
            if entry["curve"] is not None:
                grid = np.geomspace(x.min(), x.max(), 200)
                z = entry["curve"][0] + entry["curve"][1] * np.log(entry["curve"][2] + grid)
                axis.plot(scale * grid, 1.0 / (1.0 + np.exp(-z)), color=COLOURS[view],
                          label=f"{NAMES[view]}: a90/95 {scale * entry['a90_95']:.3g}")
                axis.axvline(scale * entry["a90_95"], color=COLOURS[view], linestyle=":")
        axis.set(xscale="log", title=group.replace("_", " "), xlabel=unit,
                 ylabel="probability of detection", ylim=(-0.02, 1.02))
        axis.axhline(0.9, color="0.6", linewidth=0.8)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="lower right", fontsize=8)
    figure.savefig(path, dpi=110)


def plot_reliability(numbers: Mapping[View, dict[str, Any]], path: Path) -> None:
    """Draw how often a class is there against the probability that it was given."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 5), layout="constrained")
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], color="0.6", linewidth=0.8)
    for view, found in numbers.items():
        rows = found["reliability"]
        x, y = ([r[k] for r in rows] for k in ("probability", "observed"))
        axis.plot(x, y, "o-", color=COLOURS[view], label=NAMES[view])
        for r in rows:
            axis.plot([r["probability"]] * 2, [r["lower"], r["upper"]], color=COLOURS[view],
                      alpha=0.4)
    axis.set(xlabel="probability that the verdict gives to a class",
             ylabel="how often the class was there", title="Reliability, held-out fleet")
    axis.legend()
    figure.savefig(path, dpi=110)
