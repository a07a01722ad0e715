"""The tables of the panel: outcomes, numbers beside their targets, sizes, seconds, visibility."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from benchmarks.blind_panel.judging import Row, outcome, resolved, right_port
from benchmarks.blind_panel.truth.visible import THRESHOLD
from ema_prognostics.training.rates import rate_of

Rows = Mapping[str, Sequence[Row]]
OWN_WORLD = ("own, nothing", "own, one effect", "own, two effects",
             "own, outside the catalogue", "own, accepted")
"""Strata (their beginnings) that are of the simulator and the spreads that the library has; of
accepted units also those with everything off."""


def interval(count: int, of: int) -> str:
    """Return a count with the exact bounds of its share, 95 %."""
    if not of:
        return "-"
    found = rate_of(count, of)
    return f"{count} ({100 * found.lower:.3g}-{100 * found.upper:.3g} %)"


def _of(count: int, of: int, target: str) -> str:
    return f"{interval(count, of)} of {of}{f', {target}' if target else ''}" if of else "-"


def markdown(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in Markdown."""
    return "\n".join(["| " + " | ".join(map(str, row)) + " |" for row in (
        head, *([["---"] * len(head)]), *rows)])


def table(rows: Rows) -> str:
    """Return the outcomes of all rows by stratum; seconds of CPU are the median."""
    kinds = ("right", "part", "wrong", "unknown", "silent")
    return markdown(("stratum", "units", *kinds, "s"), (
        (stratum, len(found),
         *(interval(sum(outcome(r) == k for r in found), len(found)) for k in kinds),
         f"{np.median([r['seconds'] for r in found]):.1f}") for stratum, found in rows.items()))


def _named(row: Row) -> bool:
    return outcome(row) in ("right", "part", "wrong")


def _is(*kinds: str) -> Callable[[Row], bool]:
    return lambda row: outcome(row) in kinds


def _inside(rows: Iterable[Row]) -> tuple[int, int]:
    """Return how many numbers are in their interval, of how many that can be compared."""
    found = [size["inside"] for row in rows for size in row.get("sizes", ())
             if size["inside"] is not None]
    return sum(found), len(found)


def numbers(rows: Rows, again: Mapping[str, Sequence[tuple[Row, Row | None]]]) -> str:
    """Return the numbers that are asked for, in the own world and outside.

    `again` : by stratum the answers that are sets, each with that to the proposed test, if made.
    """
    def of(world: bool, chosen: Callable[[str], bool]) -> list[Row]:
        return [r for stratum, found in rows.items() for r in found
                if stratum.startswith(OWN_WORLD) == world and chosen(stratum)]

    def since(stratum: str) -> bool:
        return "accepted" in stratum

    def whole(kind: str) -> Callable[[str], bool]:
        return lambda stratum: stratum.endswith(kind) and not since(stratum)

    asked: list[tuple[str, Callable[[str], bool], Callable[[Row], bool], str, str]] = [
        ("one effect: right name or set of at most three", whole("one effect"), _is("right"),
         ">= 97 %", ">= 90 %"),
        ("something hidden: wrong name", lambda s: not s.endswith("nothing") and not since(s),
         _is("wrong"), "<= 1 %", "<= 3 %"),
        ("nothing hidden: any name", whole("nothing"), _named, "<= 1 %", "<= 2 %"),
        ("nothing hidden: no silence", whole("nothing"), lambda r: outcome(r) != "silent", "", ""),
        ("outside the catalogue: unknown", whole("outside the catalogue"), _is("unknown"), "", ""),
        ("outside the catalogue: unknown, right port", whole("outside the catalogue"), right_port,
         ">= 92 %", ">= 85 %"),
        ("two effects: both named", whole("two effects"), _is("right"), ">= 85 %", ">= 75 %"),
        ("baseline: right", lambda s: since(s) and s.endswith("one effect"), _is("right"),
         ">= 97 %", ">= 95 %"),
        ("baseline: any name on nothing", lambda s: since(s) and s.endswith("nothing"), _named,
         "<= 1 %", "<= 1 %")]
    lines: list[Sequence[object]] = []
    for what, chosen, good, *targets in asked:
        found = [of(world, chosen) for world in (True, False)]
        lines.append((what, *(_of(sum(map(good, f)), len(f), t) for f, t in zip(found, targets))))
    inside = [_inside(of(world, lambda s: s in rows)) for world in (True, False)]
    lines.append(("number in its interval of 90 %, pooled", *(
        _of(*i, target) for i, target in zip(inside, ("87-93 %", "80-95 %")))))
    cells = []
    for world in (True, False):
        sets = [pair for stratum, pairs in again.items()
                if stratum.startswith(OWN_WORLD) == world for pair in pairs]
        proposed = [row for row, _ in sets if row.get("next")]
        done = [second for _, second in sets if second is not None]
        cells.append(_of(sum(map(resolved, done)), len(done), ">= 85 %")
                     + f"; {len(sets)} sets, {len(proposed)} with a command")
    lines.append(("set resolved by the proposed test", *cells))
    return markdown(("what", "own world", "outside"), lines)


def sizes(rows: Rows) -> str:
    """Return by effect how many of its numbers are in their interval; the median error."""
    worlds = [[size for stratum, found in rows.items() for row in found
               for size in row.get("sizes", ()) if stratum.startswith(OWN_WORLD) == world]
              for world in (True, False)]
    effects = sorted({size["name"].split(".")[0] for of in worlds for size in of})
    lines = []
    for effect in effects:
        cells: list[str] = []
        for of in worlds:
            own = [s for s in of if s["name"].startswith(f"{effect}.")]
            known = [s for s in own if s["inside"] is not None]
            off = [abs(s["value"] / s["true"] - 1.0) for s in known
                   if s["true"] and s["name"].rpartition(".")[2] not in ("phase", "angle")]
            cells.append(f"{interval(sum(s['inside'] for s in known), len(known))} of {len(known)}"
                         + (f", {100 * np.median(off):.2g} %" if off else "")
                         + (f"; {len(own) - len(known)} of another mode"
                            if len(known) < len(own) else "") if own else "-")
        lines.append((effect, *cells))
    return markdown(("effect", "own world: inside, median error", "outside"), lines)


def seconds(rows: Rows) -> str:
    """Return medians of CPU and wall seconds by what was answered."""
    kinds: dict[str, list[Row]] = {}
    for stratum, found in rows.items():
        for row in found:
            many = len(row["named"]) if _named(row) else 0
            what = outcome(row) if not many else ("one named" if many == 1 else "two named")
            since = ", with a baseline" if "accepted" in stratum else ""
            kinds.setdefault(f"{what}{since}", []).append(row)
            kinds.setdefault(f"all{since}", []).append(row)
    return markdown(("answer", "units", "CPU, s", "wall, s", "longest wall, s"), (
        (kind, len(of), f"{np.median([r['seconds'] for r in of]):.1f}",
         f"{np.median([r.get('wall', np.nan) for r in of]):.1f}",
         f"{max(r.get('wall', np.nan) for r in of):.1f}") for kind, of in sorted(kinds.items())))


def not_right(rows: Rows) -> str:
    """Return the units that are not answered as they should be, with what is hidden in them."""
    lines = []
    for stratum, found in rows.items():
        due = ("silent" if stratum.endswith("nothing") else
               "unknown" if stratum.endswith("outside the catalogue") else "right")
        lines += [(stratum, row["k"], " + ".join(row["names"]) or "nothing", row["verdict"],
                   "; ".join("/".join(names) for names in row["named"]) or row["port"] or "-")
                  for row in found if outcome(row) != due]
    return markdown(("not as it should be", "number", "hidden", "verdict", "named, or port"),
                    lines)


def visible(rows: Sequence[tuple[str, Row, float]]) -> str:
    """Return by stratum how many are visible, how many of these are right, what is not seen.

    `rows` : stratum, answer and gap (noise floors) of each unit.
    """
    lines: list[Sequence[object]] = []
    for stratum in dict.fromkeys(stratum for stratum, *_ in rows):
        own = [(row, gap) for name, row, gap in rows if name == stratum]
        seen = [row for row, gap in own if gap >= THRESHOLD]
        lines.append((
            stratum, len(own), len(seen), sum(outcome(row) == "right" for row in seen),
            "; ".join(f"{'+'.join(row['names'])} {gap:.1f} {outcome(row)}" for row, gap in own
                      if outcome(row) != "right") or "-"))
    return markdown(("stratum", "units", "visible", "right of these", "not right, gap, outcome"),
                    lines)
