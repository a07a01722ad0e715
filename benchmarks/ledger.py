"""Results of a benchmark, a line each, so that a long run can be cut short and resumed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple


class Row(NamedTuple):
    """One line of a table of targets."""

    what: str
    target: str
    found: str
    good: bool


class Ledger:
    """Results by key, kept in a file of JSON lines.

    Parameters
    ----------
    path : the file, None to keep nothing. A key names everything that the result depends on.
    """

    def __init__(self, path: Path | None = None) -> None:
        """Read what an earlier run left; a line that was cut is done again."""
        self._path = path
        self._done: dict[str, Any] = {}
        if path is not None and path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    key, result = json.loads(line)
                except ValueError:
                    continue
                self._done[key] = result

    @property
    def keys(self) -> set[str]:
        """Return what is done."""
        return set(self._done)

    def run(self, key: str, make: Callable[[], Any]) -> Any:
        """Return the result of `key`, made now unless it is there."""
        if key not in self._done:
            self._done[key] = make()
            if self._path is not None:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                with self._path.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps([key, self._done[key]]) + "\n")
        return self._done[key]
