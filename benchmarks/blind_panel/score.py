"""The scorer: ``python -m benchmarks.blind_panel.score --out DIR [--part N/M]``.

Opens the answers, decides what is visible (by simulation, kept beside the answers), judges all
units that have a result, prints the table and writes ``scores.json``.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.blind_panel.judge import Judgement, judge
from benchmarks.blind_panel.layout import PEER, PEER_CV, RESULTS, SEALED, add_common, part_of
from benchmarks.blind_panel.table import breakdown, mistakes, table
from benchmarks.blind_panel.tasks import share
from benchmarks.blind_panel.truth.cases import Case
from benchmarks.blind_panel.truth.seal import commitment_of, unseal
from benchmarks.blind_panel.truth.visible import Floor, make_floor, visible_parts
from ema_cli.console import track
from ema_record.files import new_file

FLOORS = {"extended": "floor.npz", "step": "floor_step.npz"}
"""By the command of the first record."""
VISIBLE = "visible"


def visible_of(case: Case, sealed: Path, floors: dict[str, Floor]) -> dict[str, tuple[float, str]]:
    """Return the gaps of what is hidden, computed once."""
    path = sealed / VISIBLE / f"{case.id}.json"
    if not path.exists():
        if case.first not in floors:
            floors[case.first] = make_floor(sealed / FLOORS[case.first], case.first)
        parts = visible_parts(case, floors[case.first])
        with new_file(path) as temporary:
            temporary.write_text(json.dumps(parts), encoding="utf-8")
    data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return {name: (float(gap), str(block)) for name, (gap, block) in data.items()}


def judge_all(out: Path, folder: str, cases: list[Case]) -> list[Judgement]:
    """Judge every unit of `cases` that has a result in `folder`."""
    sealed = out / SEALED
    (sealed / VISIBLE).mkdir(exist_ok=True)
    floors: dict[str, Floor] = {}
    judged = []
    for case in track(cases, "score", len(cases)):
        path = out / folder / f"{case.id}.json"
        if not path.exists():
            continue
        answer = json.loads(path.read_text(encoding="utf-8"))
        again = out / folder / f"{case.id}.next.json"
        second = json.loads(again.read_text(encoding="utf-8")) if again.exists() else None
        judged.append(judge(case, answer, visible_of(case, sealed, floors), second))
    return judged


def main() -> None:
    """Read the command line and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_common(parser)
    parser.add_argument("--mistakes", action="store_true", help="list what was wrong")
    given = parser.parse_args()
    cases = share(unseal(given.out / SEALED), part_of(given.part))
    print(f"answers as committed, SHA-256 {commitment_of(given.out / SEALED)}")
    columns = {
        name: judge_all(given.out, folder, cases)
        for name, folder in (("ema identify", RESULTS), ("STLSQ, calibrated", PEER),
                             ("STLSQ, cross-validated", PEER_CV))
        if (given.out / folder).exists()
    }
    print(f"part {given.part}: {len(cases)} units\n")
    print(table(columns))
    for name, judged in columns.items():
        print(f"\n{name}, by effect\n{breakdown(judged)}")
    if given.mistakes:
        for name, judged in columns.items():
            print(f"\n{name}, mistakes\n{mistakes(judged)}")
    scores = given.out / f"scores_{given.part.replace('/', '_of_')}.json"
    scores.write_text(json.dumps(
        {name: [asdict(j) for j in judged] for name, judged in columns.items()}), "utf-8")


if __name__ == "__main__":
    main()
