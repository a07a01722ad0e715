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

from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from benchmarks.blind_panel.judge import Judgement, judge
from benchmarks.blind_panel.layout import RESULTS, SEALED, add_common, part_of
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


def make_visible(cases: list[Case], sealed: Path, workers: int) -> None:
    """Compute the gaps of what is hidden in `cases`, those that are not there yet."""
    (sealed / VISIBLE).mkdir(exist_ok=True)
    todo = [case for case in cases if not (sealed / VISIBLE / f"{case.id}.json").exists()]
    floors = {first: make_floor(sealed / FLOORS[first], first) for first in
              sorted({case.first for case in todo})}
    done = Parallel(n_jobs=workers, return_as="generator")(
        delayed(_write_visible)(case, floors[case.first], sealed) for case in todo)
    for _ in track(done, "visible", len(todo)):
        pass


def _write_visible(case: Case, floor: Floor, sealed: Path) -> None:
    with threadpool_limits(limits=1):
        parts = visible_parts(case, floor)
    with new_file(sealed / VISIBLE / f"{case.id}.json") as temporary:
        temporary.write_text(json.dumps(parts), encoding="utf-8")


def visible_of(case: Case, sealed: Path) -> dict[str, tuple[float, str]]:
    """Return the gaps of what is hidden in a case."""
    path = sealed / VISIBLE / f"{case.id}.json"
    data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return {name: (float(gap), str(block)) for name, (gap, block) in data.items()}


def judge_all(out: Path, folder: str, cases: list[Case], workers: int = 1) -> list[Judgement]:
    """Judge every unit of `cases` that has a result in `folder`."""
    answered = [case for case in cases if (out / folder / f"{case.id}.json").exists()]
    make_visible(answered, out / SEALED, workers)
    judged = []
    for case in answered:
        answer = json.loads((out / folder / f"{case.id}.json").read_text(encoding="utf-8"))
        again = out / folder / f"{case.id}.next.json"
        second = json.loads(again.read_text(encoding="utf-8")) if again.exists() else None
        judged.append(judge(case, answer, visible_of(case, out / SEALED), second))
    return judged


def main() -> None:
    """Read the command line and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_common(parser)
    parser.add_argument("--mistakes", action="store_true", help="list what was wrong")
    given = parser.parse_args()
    cases = share(unseal(given.out / SEALED), part_of(given.part))
    print(f"answers as committed, SHA-256 {commitment_of(given.out / SEALED)}")
    columns = {"ema identify": judge_all(given.out, RESULTS, cases, given.workers)}
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
