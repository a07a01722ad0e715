"""Verdicts that were given: kept by the content of the bag and by all that judged it.

One SQLite file. A bag's content is known by its SHA-256, which is taken again only where the
names, sizes or times of its files have changed (as git does it). What cannot be written is not
kept, and a damaged file counts as empty: the store saves time and decides nothing.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ema_record.array_cache import cache_directory
from ema_record.bag.content_hash import content_hash, files_state

FILE = "verdicts.sqlite"
FORM = 1
"""Of the tables; others are left alone, under another name."""
TICK = 2_000_000_000
"""Coarsest clock of a file system (ns): what was written within it may be written again unseen."""
NEEDED = {"record_sha256", "bag", "verdict", "faults", "reasons", "probabilities", "kit",
          "serial_number", "start_time", "profile"}
"""Keys of what is kept: an object without them was not written here."""
WAIT = 10.0
"""For another process that writes (s)."""
_TABLES = """
CREATE TABLE IF NOT EXISTS bags (path TEXT PRIMARY KEY, state TEXT, sha256 TEXT) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS verdicts (
    judge TEXT, sha256 TEXT, object TEXT, PRIMARY KEY (judge, sha256)) WITHOUT ROWID;
"""


class VerdictStore:
    """Verdicts of one judge.

    Parameters
    ----------
    judge : hash of all that a verdict depends on beside the bag.
    folder : where the store is, default the user's cache.
    """

    def __init__(self, judge: str, folder: Path | None = None) -> None:
        folder = cache_directory() if folder is None else folder
        self.judge = judge
        self._hashed: list[tuple[str, ...]] = []  # not yet written
        self._base = self._open(folder / f"v{FORM}_{FILE}")
        self._states = dict(self._rows("SELECT path, state || char(10) || sha256 FROM bags"))
        self._verdicts = dict(self._rows(
            "SELECT sha256, object FROM verdicts WHERE judge = ?", judge))

    def __enter__(self) -> VerdictStore:
        return self

    def __exit__(self, *_: object) -> None:
        """Keep what is not kept yet; close it."""
        self.put(())
        self._base.close()

    @staticmethod
    def _open(path: Path) -> sqlite3.Connection:
        base = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            base = sqlite3.connect(path, timeout=WAIT)
            base.executescript(_TABLES)
        except (OSError, sqlite3.Error):
            if base is not None:
                base.close()
            base = sqlite3.connect(":memory:")
            base.executescript(_TABLES)
        return base

    def _rows(self, query: str, *values: str) -> list[tuple[str, str]]:
        try:
            return [row for row in self._base.execute(query, values)
                    if all(isinstance(text, str) for text in row)]
        except sqlite3.Error:
            return []

    def sha256(self, bag: Path) -> str | None:
        """Return the content hash of a bag, None where it cannot be read."""
        place = in_utf8(str(bag.absolute()))
        try:
            state, latest = files_state(bag)
            state = in_utf8(state)
            known = self._states.get(place, "").rpartition("\n")
            if known[0] == state:
                return known[2]
            found = content_hash(bag)
        except OSError:
            return None
        if time.time_ns() - latest > TICK:
            self._states[place] = f"{state}\n{found}"
            self._hashed.append((place, state, found))
        return found

    def get(self, sha256: str | None) -> dict[str, Any] | None:
        """Return what was said of a bag of this content, None where nothing was."""
        text = self._verdicts.get(sha256 or "")
        try:
            found = None if text is None else json.loads(text)
        except (ValueError, RecursionError):
            return None
        if not isinstance(found, dict) or not found.keys() >= NEEDED:
            return None
        return found if found["record_sha256"] == sha256 else None

    def put(self, said: Iterable[tuple[str, dict[str, Any]]]) -> None:
        """Keep what was said of bags of these contents, and the hashes that were taken."""
        rows = [(self.judge, sha256, json.dumps(found, sort_keys=True)) for sha256, found in said]
        self._verdicts.update({sha256: text for _, sha256, text in rows})
        self._write("INSERT OR REPLACE INTO bags VALUES (?, ?, ?)", self._hashed)
        self._write("INSERT OR REPLACE INTO verdicts VALUES (?, ?, ?)", rows)
        self._hashed.clear()

    def _write(self, query: str, rows: Sequence[tuple[str, ...]]) -> None:
        with contextlib.suppress(sqlite3.Error), self._base:  # which ends the transaction
            self._base.executemany(query, rows)


def in_utf8(text: str) -> str:
    """Return a text with names of files that are not UTF-8 escaped."""
    return text.encode("utf-8", "backslashreplace").decode()
