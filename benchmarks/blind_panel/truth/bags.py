"""The bags of a unit, as `ema` writes them; nothing in them tells the answer."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

from benchmarks.blind_panel.tasks import ACCEPTED, HELD_OUT, MEASURED, NEXT
from benchmarks.blind_panel.truth.answers import Answer
from ema_record.bag.read import write_bag
from ema_record.files import sync_directory
from ema_record.profile import Profile
from ema_record.record import Provenance, Record

START_TIME, BETWEEN = 1_795_000_000_000_000_000, 600 * 10**9
"""Of the first test of every unit (ns since the epoch), and between two tests (ns)."""


def make_bags(answer: Answer, folder: Path) -> None:
    """Make the bags of a unit in ``folder/ID``, unless they are there."""
    if (folder / answer.id).exists():
        return
    unit = answer.unit()
    bags = {ACCEPTED.format(n): record for n, record in enumerate(unit.accepted, start=1)}
    bags[MEASURED] = unit.records[0]
    bags |= {HELD_OUT.format(n): record for n, record in enumerate(unit.records[1:], start=1)}
    partial = folder / f".{answer.id}.{os.getpid()}.tmp"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    for number, (name, record) in enumerate(bags.items()):
        _write(record, answer, number, partial / name)
    partial.replace(folder / answer.id)
    sync_directory(folder)


def make_next_bag(answer: Answer, profile: Profile, folder: Path) -> None:
    """Make the bag of a proposed test, of the same unit on another day, unless it is there."""
    final = folder / answer.id / NEXT
    if final.exists():
        return
    partial = folder / answer.id / f".{NEXT}.{os.getpid()}.tmp"
    shutil.rmtree(partial, ignore_errors=True)
    number = len(list(final.parent.iterdir()))
    partial.mkdir()  # a bag's file is named after its folder
    _write(answer.unit().again(profile), answer, number, partial / NEXT)
    (partial / NEXT).replace(final)
    partial.rmdir()
    sync_directory(final.parent)


def _write(record: Record, answer: Answer, number: int, path: Path) -> None:
    """Write one test, `number` in the life of the unit, whatever simulator it is of."""
    write_bag(replace(record, provenance=Provenance(
        serial_number=f"UNIT-{answer.id}", software_version="panel",
        start_time=START_TIME + number * BETWEEN)), path, views=False)
