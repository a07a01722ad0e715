"""The panel's table: the issue's rows, a column for each method, with bounds and counts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from benchmarks.blind_panel.judge import Judgement
from ema_prognostics.training.rates import Rate, rate

Judged = Sequence[Judgement]


def counted(outcomes: Iterable[bool | None]) -> Rate:
    """Return the rate of true ones; None does not count."""
    return rate([outcome for outcome in outcomes if outcome is not None])


def text(found: Rate) -> str:
    """Return share, 95 % bounds and counts of a rate."""
    if not found.total:
        return "–"
    return (f"{100 * found.value:.0f} % [{100 * found.lower:.0f}, {100 * found.upper:.0f}] "
            f"{found.hits}/{found.total}")


def _median(values: list[float], digits: int) -> str:
    if not values:
        return "–"
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return (f"{middle:.{digits}f} (10-90 %: {low:.{digits}f} to {high:.{digits}f}) "
            f"n = {len(values)}")


def _seen(judged: Judged, group: str) -> list[Judgement]:
    return [j for j in judged if j.group == group and j.visible]


ROWS: tuple[tuple[str, str, Callable[[Judged], str]], ...] = (
    ("right name, or a set of at most 3 with it; effect visible", ">= 95 %",
     lambda js: text(counted(j.right for j in _seen(js, "effect")))),
    ("  of these, one name alone", "",
     lambda js: text(counted(j.set_size == 1 for j in _seen(js, "effect") if j.right))),
    ("wrong name; effect visible", "<= 2 %",
     lambda js: text(counted(j.wrong for j in _seen(js, "effect")))),
    ("wrong name; all with one effect", "",
     lambda js: text(counted(j.wrong for j in js if j.group == "effect"))),
    ("any name when nothing is hidden", "<= 2 %",
     lambda js: text(counted(j.named for j in js if j.group == "nothing"))),
    ("outside the catalogue: unknown, right port", ">= 90 %",
     lambda js: text(counted(j.unknown_port for j in _seen(js, "stranger")))),
    ("  unknown, port of the right balance", "",
     lambda js: text(counted(j.unknown_balance for j in _seen(js, "stranger")))),
    ("  some name instead", "",
     lambda js: text(counted(j.named for j in _seen(js, "stranger")))),
    ("two effects, both named; both visible", ">= 80 %",
     lambda js: text(counted(j.both for j in _seen(js, "pair")))),
    ("  a name that is not hidden", "",
     lambda js: text(counted(j.wrong for j in _seen(js, "pair")))),
    ("gap closed on the held-out record, median", ">= 0.9",
     lambda js: _median([j.closed for j in [*_seen(js, "effect"), *_seen(js, "pair")]
                         if j.closed is not None], 2)),
    ("parameter within its 90 % interval", "85-95 %",
     lambda js: text(counted(c for j in js if j.visible for c in j.covered))),
    ("set resolved by the proposed next test", ">= 80 %",
     lambda js: text(counted(j.resolved for j in js))),
    ("  set that is said to need more than a test", "",
     lambda js: text(counted(j.without_test for j in js))),
    ("no answer (error)", "", lambda js: text(counted(j.error for j in js))),
    ("time a record (s), median", "<= 60", lambda js: _median([j.seconds for j in js], 1)),
)


def _grid(rows: list[list[str]]) -> str:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths)).rstrip() for row in rows]
    lines.insert(1, "  ".join("-" * w for w in widths))
    return "\n".join(lines)


def table(columns: dict[str, Judged]) -> str:
    """Return the table as text: share, 95 % bounds, hits/count."""
    rows = [["what", "target", *columns]]
    rows += [[name, target, *(measure(js) for js in columns.values())]
             for name, target, measure in ROWS]
    rows.append(["units judged", "", *(str(len(js)) for js in columns.values())])
    return _grid(rows)


def breakdown(judged: Judged) -> str:
    """Return right, wrong and visible by effect."""
    rows = [["effect", "units", "visible", "right", "wrong", "closed", "in interval"]]
    singles = [j for j in judged if j.group == "effect"]
    for name in sorted({j.names[0] for j in singles}):
        mine = [j for j in singles if j.names[0] == name]
        seen = [j for j in mine if j.visible]
        closed = [j.closed for j in seen if j.closed is not None]
        right, wrong = counted(j.right for j in seen), counted(j.wrong for j in mine)
        inside = counted(c for j in seen for c in j.covered)
        rows.append([
            name, str(len(mine)), str(len(seen)), f"{right.hits}/{right.total}",
            f"{wrong.hits}/{wrong.total}", f"{np.median(closed):.2f}" if closed else "–",
            f"{inside.hits}/{inside.total}",
        ])
    return _grid(rows)


def mistakes(judged: Judged) -> str:
    """Return the units whose answer is not the right one, with the truth: for the autopsy."""
    rows = [["unit", "hidden", "size", "gap", "answer"]]
    for j in judged:
        bad = {"effect": j.wrong or (j.visible and not j.right), "nothing": j.named,
               "stranger": j.visible and not j.unknown_port, "pair": j.visible and not j.both}
        if bad[j.group]:
            rows.append([j.id, " + ".join(j.names) or "nothing", j.size or j.group,
                         f"{j.gap:.1f}", j.answer])
    return _grid(rows)
