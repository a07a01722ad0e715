"""The rates of all panels in one table: ``python -m benchmarks.blind_panel.rates``.

What each panel found stands in ``rates.csv``; the table is that of ``docs/identification.md``.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from ema_prognostics.training.rates import rate_of

RECENT = 64
"""First panel of the decision as it is, but for rules that changed little."""
ROWS = {
    "one, own": ("one effect, right name or set: own", "≥ 97 %"),
    "one, own, everything off": ("own, everything off", "≥ 90 %"),
    "one, own, bands x 1.3": ("own, up to 1.3 times as far off as allowed", "≥ 90 %"),
    "one, second": ("second simulator", "≥ 90 %"),
    "one, PWM": ("second simulator, PWM", "≥ 90 %"),
    "one, FOC": ("second simulator, FOC", "≥ 90 %"),
    "two, own": ("two effects, both named: own", "≥ 85 %"),
    "two, own, everything off": ("own, everything off", "≥ 75 %"),
    "two, second": ("second simulator", "≥ 75 %"),
    "outside, own": ("outside the catalogue, unknown and right place: own", "≥ 92 %"),
    "outside, second": ("second simulator", "≥ 85 %"),
    "accepted, own": ("changed since acceptance, right: own", "≥ 97 %"),
    "accepted, second": ("second simulator", "≥ 95 %"),
    "wrong name": ("any wrong name where something is hidden", "≤ 1; 3 %"),
    "nothing, own": ("nothing hidden, any name: own", "≤ 1 %"),
    "nothing, own, everything off": ("own, everything off", "≤ 2 %"),
    "nothing, second": ("second simulator", "≤ 2 %"),
    "nothing, PWM and FOC": ("both simulators, PWM and FOC", "≤ 2 %"),
    "nothing, own, bands x 1.3": ("own, up to 1.3 times as far off", "≤ 2 %"),
    "nothing, second, bands x 1.3": ("second simulator, up to 1.3 times as far off", "≤ 2 %"),
    "nothing since acceptance, own": ("nothing changed since acceptance: own", "≤ 1 %"),
    "nothing since acceptance, second": ("second simulator", "≤ 1 %"),
    "interval, own": ("numbers in their 90 % interval: own", "87-93 %"),
    "interval, other": ("everything off or outside", "80-95 %"),
}
"""Rows of the table, and what is asked of each."""


class Found(NamedTuple):
    """What a panel found in a row."""

    panel: str
    """Its number; ``47-53`` of some."""
    row: str
    right: int
    of: int

    @property
    def first(self) -> int:
        """Number of the panel, of the first of some."""
        return int(self.panel.split("-")[0])


def all_found() -> list[Found]:
    """Return what all panels found, in their order."""
    with Path(__file__).with_name("rates.csv").open(encoding="utf-8") as file:
        return [Found(row["panel"], row["row"], int(row["right"]), int(row["of"]))
                for row in csv.DictReader(file)]


def pooled(found: Iterable[Found], row: str, since: int = 0) -> tuple[int, int]:
    """Return how many were counted in a row, of how many, in panels from `since` on."""
    kept = [f for f in found if f.row == row and f.first >= since]
    return sum(f.right for f in kept), sum(f.of for f in kept)


def said(right: int, of: int) -> str:
    """Return a rate as it is written, with its exact bounds of 95 %."""
    if not of:
        return ""
    bounds = rate_of(right, of)
    return f"{right} of {of} ({100 * bounds.lower:.3g} to {100 * bounds.upper:.3g} %)"


def table() -> str:
    """Return the table, in Markdown."""
    found = all_found()
    lines = [f"| | asked | all | since panel {RECENT} |", "|---|---|---|---|"]
    for row, (what, asked) in ROWS.items():
        cells = [said(*pooled(found, row)), said(*pooled(found, row, RECENT))]
        lines.append(f"| {what} | {asked} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
