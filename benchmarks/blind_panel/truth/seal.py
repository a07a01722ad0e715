"""The sealed answers: a commitment before the runs, the text only for who holds the key.

The file is enciphered with a stream (SHAKE-256) of a random key, so that nothing that looks
into it by chance reads an answer; the commitment (SHA-256 of key and plain text) is printed
before the runs and checked when the answers are opened. A panel that is run with more units
than before has them sealed as a further part.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.blind_panel.truth.answers import Answer
from ema_record.errors import InvalidRecordError

ANSWERS, KEY, COMMITMENT = "answers.sealed", "key", "commitment.txt"


def parts(sealed: Path) -> list[Path]:
    """Return the folders of all parts, in order."""
    return sorted(sealed.glob("[0-9]*"), key=lambda part: int(part.name))


def seal(answers: Sequence[Answer], sealed: Path) -> Path:
    """Write answers, key and commitment as a further part, whole or not at all; return it."""
    final = sealed / str(len(parts(sealed)) + 1)
    partial = sealed / f".{final.name}.{secrets.token_hex(4)}.tmp"
    sealed.mkdir(parents=True, mode=0o700, exist_ok=True)
    partial.mkdir(mode=0o700)
    key = secrets.token_bytes(32)
    plain = json.dumps([asdict(answer) for answer in answers], sort_keys=True).encode()
    commitment = hashlib.sha256(key + plain).hexdigest()
    for name, data in ((KEY, key), (COMMITMENT, f"{commitment}\n".encode()),
                       (ANSWERS, _stream(key, plain))):
        (partial / name).write_bytes(data)
        (partial / name).chmod(0o600)
    return partial.replace(final)


def commitment_of(part: Path) -> str:
    """Return the commitment that was made."""
    return (part / COMMITMENT).read_text(encoding="utf-8").strip()


def unseal(part: Path) -> list[Answer]:
    """Open the answers of a part.

    Raises
    ------
    InvalidRecordError
        They are not those that were committed to, or not there.
    """
    try:
        key, committed = (part / KEY).read_bytes(), commitment_of(part)
        plain = _stream(key, (part / ANSWERS).read_bytes())
    except OSError as error:
        raise InvalidRecordError(f"{error.filename}: {error.strerror}: make a new panel") from None
    found = hashlib.sha256(key + plain).hexdigest()
    if found != committed:
        raise InvalidRecordError(f"{part / ANSWERS}: is not what was committed to "
                                 f"({found[:16]}...): make a new panel")
    return [Answer.from_dict(data) for data in json.loads(plain)]


def _stream(key: bytes, data: bytes) -> bytes:
    """Return `data` combined with the key's stream; twice gives `data` back."""
    stream = hashlib.shake_256(key).digest(len(data))
    return bytes(one ^ other for one, other in zip(data, stream))
