"""Rates of verdicts with exact bounds, beside the targets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from benchmarks.any_actuator.cases import CLASS
from ema_prognostics.training.rates import Rate, rate

Row = dict[str, Any]


class Target(NamedTuple):
    """One number of the benchmark; what is wanted of its rate."""

    what: str
    least: float
    most: float


TARGETS = (
    Target("healthy called a fault", 0.0, 0.02), Target("healthy called unknown", 0.0, 0.03),
    Target("right class", 0.97, 1.0), Target("right phase", 0.98, 1.0),
    Target("severity in its interval", 0.85, 0.95),
    Target("strangers and sensor faults not told", 0.0, 0.05),
)
POOLED = {"healthy called a fault": 0.01}
"""Where the pooled rate has another upper target."""


def is_right(row: Row) -> bool:
    """Whether the class is named; one that the verdict says looks alike counts."""
    return row["outcome"] == "fault" and CLASS[row["group"]] in (
        *row["named"], *row["alternatives"])


def rates(rows: Sequence[Row]) -> dict[str, Rate]:
    """Return the rate of each target, and of each group of faults."""
    healthy = [r for r in rows if r["group"] == "healthy"]
    faults = [r for r in rows if r["group"] in CLASS]
    named = [r for r in faults if r["interval"] is not None and r["named"]
             and r["named"][0] == CLASS[r["group"]]]
    shorts = [r for r in named if r["phase"] is not None]
    strange = [r for r in rows if r["group"] in ("stranger", "sensor")]
    found = {
        "healthy called a fault": rate([r["outcome"] == "fault" for r in healthy]),
        "healthy called unknown": rate([r["outcome"] not in ("fault", "healthy")
                                        for r in healthy]),
        "right class": rate([is_right(r) for r in faults]),
        "right phase": rate([r["named_phase"] == r["phase"] for r in shorts]),
        "severity in its interval": rate([r["interval"][0] <= r["size"] <= r["interval"][1]
                                          for r in named]),
        "strangers and sensor faults not told": rate(
            [r["outcome"] in ("fault", "healthy") for r in strange]),
    }
    for group in CLASS:
        mine = [r for r in faults if r["group"] == group]
        found[f"  {group}"] = rate([is_right(r) for r in mine])
    return found


def text_of(r: Rate) -> str:
    """Return a rate as counts with its exact 95 % bounds."""
    if r.total == 0:
        return "-"
    return f"{r.hits} of {r.total} ({100 * r.lower:.1f}-{100 * r.upper:.1f} %)"


def markdown(columns: Mapping[str, Sequence[Row]]) -> str:
    """Return the table: a column a machine and, where there are several, one pooled."""
    names = list(columns)
    if len(names) > 1:
        columns = {**columns, "pooled": [r for rows in columns.values() for r in rows]}
        names.append("pooled")
    found = {name: rates(rows) for name, rows in columns.items()}
    lines = ["| what | target | " + " | ".join(names) + " |", "|---" * (2 + len(names)) + "|"]
    wanted = {t.what: t for t in TARGETS}
    for what in next(iter(found.values())):
        target = wanted.get(what)
        cells = []
        for name in names:
            r = found[name][what]
            most = POOLED.get(what, target.most if target else 1.0) if name == "pooled" else (
                target.most if target else 1.0)
            met = r.total == 0 or target is None or target.least <= r.value <= most
            cells.append(text_of(r) if met else f"**{text_of(r)}**")
        said = "" if target is None else (
            f"≥ {100 * target.least:g} %" if target.most == 1.0 else
            f"≤ {100 * target.most:g} %" if target.least == 0.0 else
            f"{100 * target.least:g}-{100 * target.most:g} %")
        lines.append(f"| {what} | {said} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def outcomes(rows: Sequence[Row]) -> str:
    """Return, by group and detail, how often each answer was given."""
    counts: dict[str, Counter[str]] = {}
    for r in rows:
        name = f"{r['group']} {r['detail']}".strip()
        answer = "+".join(sorted(set(r["named"]))) or r["outcome"]
        counts.setdefault(name, Counter())[answer] += 1
    return "\n".join(f"{name}: " + ", ".join(f"{n} {a}" for a, n in c.most_common())
                     for name, c in counts.items())


def why_unknown(rows: Sequence[Row], most: int = 12) -> str:
    """Return the reasons for which healthy records were not judged, most frequent first."""
    found: Counter[str] = Counter()
    for r in rows:
        if r["group"] == "healthy" and r["outcome"] not in ("healthy", "fault"):
            found.update(reason.split(":")[0] for reason in r["reasons"]
                         if not reason.startswith("next:"))
    return "\n".join(f"{n} {reason}" for reason, n in found.most_common(most))
