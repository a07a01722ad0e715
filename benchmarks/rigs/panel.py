"""The synthetic panel: what is named on records of `kinds` and `wrong`, and a table of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.ledger import Ledger, Row
from benchmarks.rigs.kinds import MOTIONS, case_of
from benchmarks.rigs.wrong import SAYS, coupled_record, wrong_record
from ema_identification.result import Identification
from ema_identification.rig.verdict import MOST_UNEXPLAINED
from ema_identification.rig.workflow import identify_rig
from ema_prognostics.training.rates import rate_of
from ema_record.errors import EmaError

MORE_OF_ONE_WAY = {"coulomb_friction": "offset", "offset": "coulomb_friction"}
"""Alike where the motion never reverses."""


def panel(count: int, *, seed: int = 0, work: Path | None = None) -> list[Row]:
    """Print what is found on synthetic records, and return the table.

    Parameters
    ----------
    count : int
        Records that can be used; a fifth as many have one thing wrong, a tenth as many are of an
        axis that another one moves.
    seed : int
        Draws rigs, motions, effects and noise.
    work : Path, optional
        Lines of JSON of what is done; those that are there are not done again.

    """
    ledger = Ledger(work)
    kinds = list(SAYS)
    wrong = [
        _done(ledger, f"{seed}-wrong-{k}", partial(_wrong, kinds[k % len(kinds)], k, seed))
        for k in range(count // 5)]
    coupled = [
        _done(ledger, f"{seed}-coupled-{k}", partial(_coupled, k, seed))
        for k in range(count // 10)]
    usable = [record_answer(ledger, k, seed) for k in range(count)]
    return table(usable, wrong, coupled)


def record_answer(ledger: Ledger, number: int, seed: int) -> dict[str, Any]:
    """Return what is said of a record that can be used, from the ledger where it is there."""
    return _done(ledger, f"{seed}-{number}", partial(_usable, number, seed))


def _done(ledger: Ledger, key: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = ledger.run(key, make)
    print(f"{key:18s} {found['kind']:22s} {found['answer']:8s} {'+'.join(found['truth']):40s} "
          f"{found['said']} ({found['seconds']:.0f} s)", flush=True)
    return found


def _usable(number: int, seed: int) -> dict[str, Any]:
    """Return what is said of a record that can be used."""
    case = case_of(number, seed)
    start = time.process_time()
    try:
        found = identify_rig([case.record])
    except EmaError as error:
        return {"kind": case.kind, "truth": sorted(case.truth), "effect": case.effect,
                "answer": "refused", "said": str(error), "false": False, "overclaimed": False,
                "inside": [], "seconds": time.process_time() - start}
    sets = [{f.effect, *f.equivalent} for f in found.findings]
    if case.kind == "one way":
        sets = [names | {MORE_OF_ONE_WAY[n] for n in names if n in MORE_OF_ONE_WAY}
                for names in sets]
    false = any(not (names & case.truth) for names in sets)
    missed = [name for name in case.truth if not any(name in names for names in sets)]
    more = len(sets) > len(case.truth)  # two names for one effect
    answer = "wrong" if false or more else "missed" if missed else "right"
    if answer == "right" and found.unknown is not None:
        answer = "unknown"
    own = {p.name: p for p in found.recalibrated}
    inside = [own[name].low <= value <= own[name].high for name, value in case.base.items()
              if name in own and answer == "right"]
    return {"kind": case.kind, "truth": sorted(case.truth), "effect": case.effect,
            "answer": answer, "said": _said(found), "false": false,
            "overclaimed": _overclaimed(found), "inside": [bool(i) for i in inside],
            "seconds": time.process_time() - start}


def _wrong(kind: str, number: int, seed: int) -> dict[str, Any]:
    """Return whether a record with one thing wrong is refused by its name."""
    start = time.process_time()
    try:
        found = identify_rig([wrong_record(kind, number, seed)])
        answer, said = "missed", _said(found)
    except EmaError as error:
        said = str(error)
        answer = "named" if any(word in said for word in SAYS[kind]) else "refused"
    return {"kind": kind, "truth": [], "answer": answer, "said": said,
            "seconds": time.process_time() - start}


def _coupled(number: int, seed: int) -> dict[str, Any]:
    """Return whether an axis that another one moves is called explained."""
    start = time.process_time()
    try:
        found = identify_rig([coupled_record(number, seed)])
        over = found.exit_status == 0
        false = any("coulomb_friction" not in {f.effect, *f.equivalent} for f in found.findings)
        answer, said = ("claimed" if over else "named" if false else "silent"), _said(found)
    except EmaError as error:
        answer, said = "refused", str(error)
    return {"kind": "two axes coupled", "truth": [], "answer": answer, "said": said,
            "seconds": time.process_time() - start}


def _said(found: Identification) -> str:
    names = ", ".join("/".join((f.effect, *f.equivalent)) for f in found.findings)
    unknown = f" ? {found.unknown.text}" if found.unknown is not None else ""
    return f"{found.verdict}: {names}{unknown}"


def _overclaimed(found: Identification) -> bool:
    """Return whether too little is explained for the word."""
    return found.verdict in ("explained", "no disagreement") \
        and (found.unexplained or 0.0) > MOST_UNEXPLAINED


def share(hits: int, total: int) -> str:
    """Return a share with its 95 % interval (Clopper and Pearson)."""
    if total == 0:
        return "none done"
    found = rate_of(hits, total)
    return (f"{hits} of {total}: {100 * found.value:.1f} % "
            f"({100 * found.lower:.1f} to {100 * found.upper:.1f})")


def table(
    usable: list[dict[str, Any]], wrong: list[dict[str, Any]], coupled: list[dict[str, Any]]
) -> list[Row]:
    """Print the table, by kind and against the targets, and return its rows."""
    print("\n| kind | right | wrong name | missed | unknown | refused |\n"
          "|---|---|---|---|---|---|")
    for kind in MOTIONS:
        own = [case["answer"] for case in usable if case["kind"] == kind]
        if own:
            print(f"| {kind} | {own.count('right')} of {len(own)} | " + " | ".join(
                str(own.count(a)) for a in ("wrong", "missed", "unknown", "refused")) + " |")
    plain = [case for case in usable if not case["effect"]]
    empty = [case for case in plain if not case["truth"]]
    inside = [i for case in usable for i in case["inside"]]
    right = sum(case["answer"] == "right" for case in usable)
    false = sum(case["false"] for case in plain)
    anything = sum(case["false"] for case in empty)
    said = sum(case["answer"] == "named" for case in wrong)
    over = sum(case["overclaimed"] for case in usable) + sum(
        case["answer"] == "claimed" for case in coupled)
    seconds = max((case["seconds"] for case in usable), default=0.0)
    rows = [
        Row("exactly the right names", "≥ 95 %", share(right, len(usable)),
            right >= 0.95 * len(usable)),
        Row("a name beyond Coulomb friction where there is none", "≤ 2 %",
            share(false, len(plain)), false <= 0.02 * len(plain)),
        Row("any name where there is nothing", "≤ 1 %", share(anything, len(empty)),
            anything <= 0.01 * len(empty)),
        Row("one thing wrong, said by its name", "≥ 95 %", share(said, len(wrong)),
            said >= 0.95 * len(wrong)),
        Row("called explained with more than a quarter left, or moved by another axis", "0",
            share(over, len(usable) + len(coupled)), over == 0),
        Row("inertia and viscous friction in their 90 % interval", "85 to 95 %",
            share(sum(inside), len(inside)), 0.85 * len(inside) <= sum(inside) <= 0.95 * len(
                inside)),
        Row("longest, CPU", "15 s", f"{seconds:.0f} s", seconds <= 15.0),
    ]
    print("\n| what | target | found (95 % interval) | |\n|---|---|---|---|")
    for row in rows:
        print(f"| {row.what} | {row.target} | {row.found} | {'met' if row.good else 'not met'} |")
    return rows
