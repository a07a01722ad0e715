"""Open the answers, check what was committed to, judge all units that were identified."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from benchmarks.blind_panel import table
from benchmarks.blind_panel.judging import Row, is_set, row_of
from benchmarks.blind_panel.tasks import IDENTIFIED, SEALED
from benchmarks.blind_panel.truth.answers import Answer, Panel
from benchmarks.blind_panel.truth.prepare import opened
from benchmarks.blind_panel.truth.seal import commitment_of, parts
from benchmarks.blind_panel.truth.units import kit_of
from benchmarks.blind_panel.truth.visible import Floor, gap_of, make_floor
from benchmarks.ledger import Ledger
from ema_record.errors import UsageError


def score(out: Path, panel: Panel, *, visible: bool) -> None:
    """Print the tables of the units of a panel that were identified, keep rows beside the answers.

    `visible` : also in which of the units with one effect, or two, each can be seen at all.

    Raises
    ------
    UsageError
        Nothing of the panel is sealed.
    InvalidRecordError
        The answers are not those that were committed to.
    """
    answers = {(a.stratum, a.k): a for found in opened(out, panel) for a in found}
    if not answers:
        raise UsageError(f"{out}: holds no unit of this panel: seed, tests and strata must be "
                         "those that were sealed")
    for part in parts(out / SEALED):
        print(f"answers as committed, part {part.name}, SHA-256 {commitment_of(part)}")
    ledger = Ledger(out / IDENTIFIED)
    rows: dict[str, list[Row]] = {}
    again: dict[str, list[tuple[Row, Row | None]]] = {}
    for stratum in panel.counts:
        judged = [(a, row_of(a, ledger.run(a.id, dict))) for (of, _), a in sorted(answers.items())
                  if of == stratum and a.id in ledger.keys]
        if judged:
            rows[stratum] = [row for _, row in judged]
            again[stratum] = [
                (row, row_of(a, ledger.run(f"{a.id}/next", dict))
                 if f"{a.id}/next" in ledger.keys else None)
                for a, row in judged if is_set(row) and not a.accepted]
    print(f"{sum(map(len, rows.values()))} of {len(answers)} units identified")
    (out / SEALED / "rows.json").write_text(json.dumps(rows), encoding="utf-8")
    for text in (table.table(rows), table.numbers(rows, again), table.sizes(rows),
                 table.seconds(rows), table.not_right(rows)):
        print(f"\n{text}")
    if visible:
        print(f"\n{table.visible(_gaps(out, panel, answers, rows))}")


def _gaps(out: Path, panel: Panel, answers: Mapping[tuple[str, int], Answer],
          rows: Mapping[str, Sequence[Row]]) -> list[tuple[str, Row, float]]:
    """Return stratum, row and gap of the units with one effect or two, made once more."""
    ledger = Ledger(out / SEALED / "visible.jsonl")
    found = []
    for stratum, judged in rows.items():
        if stratum.endswith((", one effect", ", two effects")):
            kit = kit_of(stratum)
            of = f"{panel.tests[0]}{'' if kit is None else f'_{kit.name}'}"
            floor = make_floor(out / f"floor_{of}.npz", panel.tests[0], kit)
            for row in judged:
                answer = answers[stratum, row["k"]]
                gap, _ = ledger.run(answer.id, partial(_gap, answer, floor))
                found.append((stratum, row, float(gap)))
    return found


def _gap(answer: Answer, floor: Floor) -> tuple[float, str]:
    return gap_of(answer.unit(), floor)
