"""The task list that the workflow sees: names of units and what it must do without."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from ema_record.files import new_file

TASKS = "tasks.json"
BLOCKS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One unit to identify."""

    id: str
    without: tuple[str, ...] = ()


def write_tasks(tasks: list[Task], folder: Path) -> None:
    """Write the list; the order within each of `BLOCKS` blocks is that of the names.

    So a part N/M with M dividing `BLOCKS` is balanced, and the place of a name tells nothing.
    """
    listed = []
    for block in range(1, BLOCKS + 1):
        listed += sorted(share(tasks, (block, BLOCKS)), key=lambda task: task.id)
    with new_file(folder / TASKS) as path:
        path.write_text(json.dumps([{"id": t.id, "without": t.without} for t in listed], indent=0),
                        encoding="utf-8")


def read_tasks(folder: Path) -> list[Task]:
    """Return the list."""
    data = json.loads((folder / TASKS).read_text(encoding="utf-8"))
    return [Task(id=item["id"], without=tuple(item["without"])) for item in data]


def share(items: list, part: tuple[int, int]) -> list:
    """Return part N of M: consecutive items."""
    number, of = part
    first, last = (round(len(items) * k / of) for k in (number - 1, number))
    return items[first:last]
