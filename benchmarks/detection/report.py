"""What the detection benchmark shows: tables on the terminal and plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.detection.judge import CLASS, VIEWS, Judged, View, detected, of, severities
from benchmarks.detection.table import TARGETS
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


def percent(found: dict[str, Any]) -> str:
    """Return a rate in words: value, count, bounds."""
    if not found["total"]:
        return "-"
    return (f"{100 * found['value']:.1f} % ({found['hits']}/{found['total']}; "
            f"{100 * found['lower']:.1f}-{100 * found['upper']:.1f})")


def _size(group: str, value: float | None) -> str:
    scale, unit = UNITS[group.partition(",")[0]]
    return "-" if value is None else f"{scale * value:.3g} {unit.split()[0]}"


def make_table(title: str, *columns: str) -> Table:
    """Return an empty table: names to the left, numbers to the right."""
    table = Table(title=title, title_justify="left")
    for k, name in enumerate(columns):
        table.add_column(name, justify="left" if k == 0 else "right")
    return table


def _faults(result: dict[str, Any], console: Console) -> None:
    for k, view in enumerate(reversed(VIEWS)):
        table = make_table(
            f"{NAMES[view]}: faults", "fault", "detected", "a90", "a90/95", "target",
            "right class", "phase", "interval holds", "median error")
        for name, f in result["views"][view]["faults"].items():
            target = TARGETS.get(name.partition(",")[0])
            error = f["median error"]
            table.add_row(
                name, percent(f["detected"]), _size(name, f["a90"]), _size(name, f["a90_95"]),
                "-" if target is None else _size(name, target[k]), percent(f["right class"]),
                percent(f["phase right"]), percent(f["interval holds"]),
                "-" if error is None else f"{100 * error:.0f} %",
            )
        console.print(table)


def _whole(result: dict[str, Any], console: Console) -> None:
    table = make_table("Rates (95 % bounds)", "what", "target", *(NAMES[v] for v in VIEWS))
    for name, target in (
        ("false alarms", "<= 1 %, upper bound"), ("healthy called unknown", ""),
        ("right class", ">= 98 %"), ("interval holds", "87-93 %"),
        ("pairs both named", ">= 80 %"), ("strangers wrong", "<= 5 %"), ("accuracy", ""),
    ):
        table.add_row(name, target, *(percent(result["views"][v][name]) for v in VIEWS))
    table.add_row("mean confidence when wrong", "<= 0.6", *(
        f"{result['views'][v]['mean confidence when wrong'] or 0.0:.2f} "
        f"({result['views'][v]['wrong verdicts']})" for v in VIEWS))
    console.print(table)


def _counts(title: str, rows: dict[str, dict[str, int]], console: Console) -> None:
    outcomes = sorted({o for counts in rows.values() for o in counts},
                      key=lambda o: ("+" in o, o))
    table = make_table(title, "truth", *outcomes)
    for name, counts in rows.items():
        table.add_row(name, *(str(counts.get(o, 0) or "") for o in outcomes))
    console.print(table)


def print_tables(result: dict[str, Any]) -> None:
    """Print all tables of a result."""
    console = Console(width=180)
    _faults(result, console)
    _whole(result, console)
    for view in VIEWS:
        found = result["views"][view]
        _counts(f"{NAMES[view]}: confusion (single faults from their a90/95 on)",
                found["confusion"], console)
        _counts(f"{NAMES[view]}: strangers and sensor faults", found["strangers"], console)
        table = make_table(f"{NAMES[view]}: by condition", "condition", "false alarms",
                           "accuracy", "interval holds")
        for name, row in found["by condition"].items():
            table.add_row(name, *(percent(row[k]) for k in
                                  ("false alarms", "accuracy", "interval holds")))
        console.print(table)
    if "comparison" in result:
        table = make_table("Comparison on the same records", "scheme", "false alarms",
                           "right class", "strangers wrong", *UNITS)
        for name, c in result["comparison"].items():
            table.add_row(name, percent(c["false alarms"]), percent(c["right class"]),
                          percent(c["strangers wrong"]),
                          *(_size(g, c["a90_95"][g]) for g in UNITS))
        console.print(table)


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
