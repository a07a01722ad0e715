"""A row of the store that was not written here counts as absent."""

import json
import sqlite3

import pytest

from ema_prognostics.fleet.verdict_store import FILE, FORM, NEEDED, VerdictStore


@pytest.mark.parametrize("text", ["{}", "[" * 60_000, '{"verdict": "healthy"}', None, 7, b"\xff"])
def test_what_was_not_written_here_is_absent(tmp_path, text):
    whole = dict.fromkeys(NEEDED, "") | {"record_sha256": "a"}
    with VerdictStore("judge", tmp_path) as store:
        store.put([("a", whole)])
        assert store.get("a") == whole
        store.put([("b", whole)])
        assert store.get("b") is None  # of another record
        store._write("INSERT OR REPLACE INTO verdicts VALUES ('judge', 'a', ?)", [(text,)])
        store._write("INSERT OR REPLACE INTO bags VALUES ('/x', ?, 'a')", [(None,)])
    with VerdictStore("judge", tmp_path) as store:
        assert store.get("a") is None
        assert json.dumps(store._states) == "{}"


def test_a_file_that_is_no_store_is_closed(tmp_path, monkeypatch):
    (tmp_path / f"v{FORM}_{FILE}").write_bytes(b"damaged" * 1000)
    opened, connect = [], sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *given, **options: opened.append(
        connect(*given, **options)) or opened[-1])
    with VerdictStore("judge", tmp_path):
        pass
    assert len(opened) == 2
    for base in opened:
        with pytest.raises(sqlite3.ProgrammingError, match="closed"):
            base.execute("SELECT 1")
