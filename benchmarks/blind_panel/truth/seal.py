"""The sealed answers: a commitment before the runs, the text only for who holds the key.

The file is enciphered with a stream of SHA-256 over a random key, so that nothing that looks
into it by chance reads an answer; the commitment (SHA-256 of key and plain text) is printed
before the runs and checked when the answers are opened.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
from pathlib import Path

from benchmarks.blind_panel.truth.cases import Case
from ema_record.errors import InvalidRecordError
from ema_record.files import new_file

ANSWERS, KEY, COMMITMENT = "answers.sealed", "key", "commitment.txt"


def seal(cases: list[Case], folder: Path) -> str:
    """Write answers, key and commitment into `folder`; return the commitment."""
    key = secrets.token_bytes(32)
    plain = json.dumps([case.to_dict() for case in cases], sort_keys=True).encode()
    commitment = hashlib.sha256(key + plain).hexdigest()
    folder.mkdir(parents=True, mode=0o700, exist_ok=True)
    for name, data in ((KEY, key), (COMMITMENT, f"{commitment}\n".encode()),
                       (ANSWERS, _stream(key, plain))):
        with new_file(folder / name) as path:
            path.write_bytes(data)
            path.chmod(0o600)
    return commitment


def commitment_of(folder: Path) -> str:
    """Return the commitment that was made."""
    return (folder / COMMITMENT).read_text(encoding="utf-8").strip()


def unseal(folder: Path) -> list[Case]:
    """Open the answers.

    Raises
    ------
    InvalidRecordError
        They are not those that were committed to.
    """
    key = (folder / KEY).read_bytes()
    plain = _stream(key, (folder / ANSWERS).read_bytes())
    found = hashlib.sha256(key + plain).hexdigest()
    if found != commitment_of(folder):
        raise InvalidRecordError(
            f"{os.fspath(folder / ANSWERS)}: is not what was committed to ({found[:16]}...): "
            "make a new panel"
        )
    return [Case.from_dict(data) for data in json.loads(plain)]


def _stream(key: bytes, data: bytes) -> bytes:
    """Return `data` combined with the key's stream; twice gives `data` back."""
    blocks = (
        hashlib.sha256(key + count.to_bytes(8, "big")).digest()
        for count in range(-(-len(data) // 32))
    )
    stream = b"".join(blocks)[:len(data)]
    return (int.from_bytes(data, "big") ^ int.from_bytes(stream, "big")).to_bytes(
        len(data), "big")
