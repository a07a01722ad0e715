"""`ema lint` on good bags and on bags with seeded defects.

Good bags: see `good_bags`; none may have a finding, and none may be kept from its verdict.
Defects: each of `DEFECTS` in other good bags.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

from benchmarks.ledger import Ledger, Row
from benchmarks.reliability.good_bags import good_record
from ema_record.bag.read import read_bag, write_bag
from ema_record.checks.guard import guard_findings
from ema_record.checks.run import lint_bag
from support.defects import DEFECTS
from support.recording import Recording


def good(number: int, seed: int, folder: Path) -> dict[str, Any]:
    """Return what is found in one good bag, and what would keep it from its verdict."""
    rng = Random(f"good {seed} {number}")
    record, settings = good_record(rng)
    bag = write_bag(record, folder / "good", views=number % 2 == 0)
    try:
        report = lint_bag(bag)
        return {
            "profile": record.profile.name, "effects": settings,
            "findings": [f"{f.rule}: {f.message}" for f in report.findings],
            "unreadable": report.unreadable,
            "guard": [f.rule for f in guard_findings(read_bag(bag))],
        }
    finally:
        shutil.rmtree(bag)


def defects(number: int, seed: int, folder: Path) -> dict[str, Any]:
    """Return which kinds of defects were found in one good bag, and what was missed."""
    rng = Random(f"defects {seed} {number}")
    record, settings = good_record(rng)
    found: list[str] = []
    missed: dict[str, str] = {}
    for name, kind in DEFECTS.items():
        recording = Recording.of(record, folder / "source")
        shutil.rmtree(folder / "source")
        kind.make(recording, rng)
        report = lint_bag(recording.write(folder / "defect"))
        shutil.rmtree(folder / "defect")
        rules = {finding.rule for finding in report.findings}
        if kind.rules & rules:
            found.append(name)
        else:
            missed[name] = f"{sorted(rules)} {report.unreadable or ''}"
    return {"profile": record.profile.name, "effects": settings, "found": found,
            "missed": missed}


def measure(ledger: Ledger, seed: int, *, bags: int, good_bags: int) -> list[Row]:
    """Put each defect into `bags`, none into `good_bags`; print what went wrong."""
    wrong = blocked = found = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(good_bags):
            result = ledger.run(f"good {seed} {number}", partial(good, number, seed, folder))
            bad = bool(result["findings"] or result["unreadable"])
            wrong += bad
            blocked += bool(result["guard"])
            if bad or result["guard"]:
                print(json.dumps({"good": number, **result}), flush=True)
        for number in range(bags):
            result = ledger.run(f"defects {seed} {number}",
                                partial(defects, number, seed, folder))
            found += len(result["found"])
            if result["missed"]:
                print(json.dumps({"defects": number, **result, "found": ""}), flush=True)
    total = bags * len(DEFECTS)
    return [
        Row(f"{len(DEFECTS)} kinds of defects x {bags} bags", ">= 99 % found",
            f"{found} of {total}", found >= 0.99 * total),
        Row(f"{good_bags} good bags", "0 findings",
            f"{wrong} with findings, {blocked} kept from a verdict", wrong == 0 == blocked),
    ]
