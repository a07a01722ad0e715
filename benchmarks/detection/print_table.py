"""The tables of the detection benchmark on the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.detection.judge import VIEWS
from benchmarks.detection.plots import NAMES, UNITS
from benchmarks.detection.table import TARGETS


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
