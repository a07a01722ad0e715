"""A process that records is killed, its disk fills up, its directory goes: what is lost.

Each child records a simulated test in real time (20 kHz, blocks of 500 samples) with
`BagWriter` and notes in shared memory how many samples it was given. At a random moment the parent
kills it (SIGKILL) or removes its directory; or its file may not grow beyond a random size. Then
the bag is recovered and compared.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import random
import resource
import shutil
import signal
import struct
import tempfile
import threading
import time
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.ledger import Ledger, Row
from ema_record.bag.read import read_bag
from ema_record.bag.recover import recover_bag
from ema_record.bag.writer import BagWriter
from ema_record.errors import IncompleteRecordError, OutputError, RecordError
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_record.wire.samples import BLOCK_SIZE, encode_block
from ema_record.wire.topics import COMMAND, SAMPLES
from ema_record.wire.trajectory import encode_command
from ema_sim.simulate import simulate

PARALLEL = 6
BATCH = 20
"""Recordings of which the results are kept together."""
TARGET_MS = 100.0


class Child(NamedTuple):
    """A recording process."""

    pid: int
    bag: Path
    given: mmap.mmap
    """Samples given to the writer, 8 bytes; then 1 where it is closed, 1 where it is open."""
    end: float
    """When it is struck (monotonic s)."""
    kind: str
    """kill, full disk or removed directory."""


def record_in_real_time(record: Record, bag: Path, given: mmap.mmap) -> None:
    """Write `record` as it would come from the acquisition."""
    with BagWriter(bag, profile=record.profile, provenance=record.provenance) as writer:
        begin = time.monotonic()
        given[9] = 1
        writer.write_raw(COMMAND, encode_command(record.profile, 1), 1)
        for first in range(0, len(record), BLOCK_SIZE):
            block = record.samples[first:first + BLOCK_SIZE]
            time.sleep(max(0.0, begin + block[-1, 0] - time.monotonic()))
            given[:8] = struct.pack("<Q", first + len(block))
            writer.write_raw(SAMPLES, encode_block(block), 1 + int(block[-1, 0] * 1e9))
        writer.close()
    given[8] = 1


def start(record: Record, bag: Path, rng: random.Random, kind: str) -> Child:
    """Fork a recording process that will be struck at a random moment."""
    length = float(record.time[-1])
    wait = rng.uniform(0.0, length + 0.02) if kind == "kill" else rng.uniform(0.0, length - 0.1)
    room = rng.randrange(20_000, 1_000_000)
    given = mmap.mmap(-1, 16)
    pid = os.fork()
    if pid == 0:
        try:
            if kind == "full disk":
                resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
            with contextlib.suppress(OutputError):
                record_in_real_time(record, bag, given)
        finally:
            os._exit(0)
    while not given[9]:
        time.sleep(1e-3)
    # In time, whatever this process does: the child is not reaped before it is judged.
    if kind == "kill":
        threading.Timer(wait, os.kill, [pid, signal.SIGKILL]).start()
    elif kind == "removed directory":  # which may be put back meanwhile
        threading.Timer(wait, shutil.rmtree, [bag], {"ignore_errors": True}).start()
    return Child(pid, bag, given, time.monotonic() + wait, kind)


def judge(child: Child, record: Record) -> dict[str, object]:
    """Wait for the end of a child, recover its bag, compare."""
    os.waitpid(child.pid, 0)
    (given,) = struct.unpack("<Q", child.given[:8])
    try:
        original = read_bag(child.bag)
        whole = np.array_equal(original.samples, record.samples)
        return {"kind": child.kind, "finished": whole, "called_complete": not whole,
                "lost_ms": 0.0, "recovered": True}
    except RecordError:
        pass
    before = {p: p.read_bytes() for p in child.bag.glob("*")}
    n, status = 0, "interrupted"
    with contextlib.suppress(IncompleteRecordError):  # no sample is left
        report = recover_bag(child.bag)
        back = read_bag(report.bag)
        n, status = len(back), back.provenance.status
    same = before == {p: p.read_bytes() for p in child.bag.glob("*")} and (
        n == 0 or np.array_equal(back.samples, record.samples[:n]))
    return {"kind": child.kind, "finished": False, "called_complete": status == "complete",
            "lost_ms": 1e3 * (given - n) / record.rate, "recovered": same}


def strike_all(kinds: list[str], seed: int) -> list[dict[str, object]]:
    """Return what came of each recording process."""
    rng = random.Random(seed)
    record = simulate(load_profile("extended"), seed=seed)
    results = []
    with tempfile.TemporaryDirectory() as folder:
        running: list[Child] = []
        waiting = list(enumerate(kinds))
        while waiting or running:
            while waiting and len(running) < PARALLEL:
                number, kind = waiting.pop(0)
                running.append(start(record, Path(folder) / f"bag{number}", rng, kind))
            child = min(running, key=lambda c: c.end)
            time.sleep(max(0.0, child.end - time.monotonic()))
            running.remove(child)
            results.append(judge(child, record))
    return results


def row_of(words: str, results: list[dict[str, object]]) -> Row:
    """Return the sums over one kind."""
    struck = [r for r in results if not r["finished"]]
    lost = max([float(r["lost_ms"]) for r in struck] or [0.0])  # type: ignore[arg-type]
    recovered = sum(bool(r["recovered"]) for r in struck)
    complete = sum(bool(r["called_complete"]) for r in results)
    return Row(
        f"{len(results)} {words}", "<= 100 ms lost each, all recoverable, 0 called complete",
        f"{lost:.0f} ms at most, {recovered} of {len(struck)} recovered "
        f"({len(results) - len(struck)} whole), {complete} called complete",
        lost <= TARGET_MS and complete == 0 and recovered == len(struck),
    )


def measure(ledger: Ledger, seed: int, *, kills: int, others: int) -> list[Row]:
    """Strike `kills` recordings, fill `others` disks and remove as many directories."""
    rows = []
    for kind, words, count in (("kill", "SIGKILLs while recording", kills),
                               ("full disk", "disks that fill up", others),
                               ("removed directory", "directories removed", others)):
        results: list[dict[str, object]] = []
        for first in range(0, count, BATCH):
            kinds = [kind] * min(BATCH, count - first)
            number = 1000 * seed + first
            results += ledger.run(f"{number} {kind} {len(kinds)}",
                                  partial(strike_all, kinds, number))
        rows.append(row_of(words, results))
    return rows
