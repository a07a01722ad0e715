"""What the process that identifies sees of a panel: tasks, bags, kits; where all of it lies."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path

from ema_record.kit import using_kit

SEALED = "sealed"
"""Folder of the answers, and of all that tells of them: not for the process that identifies."""
BAGS = "bags"
"""A folder a unit, with a bag a test: `MEASURED`, `HELD_OUT`, `ACCEPTED`, `NEXT`."""
MEASURED, NEXT = "measured", "next"
HELD_OUT, ACCEPTED = "held_out_{}", "accepted_{}"
"""Numbered from 1."""
IDENTIFIED = "identified.jsonl"
"""Ledger of what is said of each unit, by its id; ``ID/next``: with the proposed test too."""
TASKS = "tasks.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One unit to identify."""

    id: str
    tests: tuple[str, ...]
    """Names of the profiles: of the measured record, then of those that are held out."""
    kit: str = ""
    """Name of a machine of `benchmarks.any_actuator`, empty for the present kit's actuator."""
    without: tuple[str, ...] = ()
    """Effects that are not in its catalogue."""


def write_tasks(tasks: Sequence[Task], out: Path) -> None:
    """Write the list of what is to be identified now, in place of an earlier one."""
    temporary = out / f".{TASKS}.tmp"
    temporary.write_text(json.dumps([asdict(task) for task in tasks], indent=0), encoding="utf-8")
    temporary.replace(out / TASKS)


def read_tasks(out: Path) -> list[Task]:
    """Return the list."""
    return [Task(id=item["id"], tests=tuple(item["tests"]), kit=item["kit"],
                 without=tuple(item["without"]))
            for item in json.loads((out / TASKS).read_text(encoding="utf-8"))]


def made_kit(name: str, out: Path) -> Path:
    """Return where a machine's kit lies once it is made."""
    return out / "kits" / name


def on_kit(kit: Path | None) -> AbstractContextManager[object]:
    """Return a context in which a kit is the present one; None: as it is."""
    return nullcontext() if kit is None else using_kit(kit)
