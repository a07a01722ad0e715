"""SIGKILL of a process that records, at random moments: what is lost, what is recovered.

Each child records a simulated test in real time (20 kHz, blocks of 500 samples) with
`BagWriter` and notes in shared memory how many samples it was given. The parent kills it,
recovers the bag and compares.

Run: python -m benchmarks.reliability.kills [--kills 200] [--seed 6]
"""

from __future__ import annotations

import argparse
import json
import mmap
import os
import random
import signal
import struct
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ema_record.bag import read_bag
from ema_record.errors import RecordError
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_record.recover import recover_bag
from ema_record.samples_codec import BLOCK_SIZE, encode_block
from ema_record.topics import COMMAND, SAMPLES
from ema_record.trajectory import encode_command
from ema_record.writer import BagWriter
from ema_sim.simulate import simulate

PARALLEL = 6
TARGET_MS = 100.0


class Child(NamedTuple):
    """A recording process."""

    pid: int
    bag: Path
    given: mmap.mmap
    """Samples given to the writer, 8 bytes; then 1 where it is closed, 1 where it is open."""
    end: float
    """When it is killed (monotonic s)."""


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


def start(record: Record, bag: Path, wait: float) -> Child:
    """Fork a recording process that will live for `wait` s."""
    given = mmap.mmap(-1, 16)
    pid = os.fork()
    if pid == 0:
        try:
            record_in_real_time(record, bag, given)
        finally:
            os._exit(0)
    while not given[9]:
        time.sleep(1e-3)
    return Child(pid, bag, given, time.monotonic() + wait)


def judge(child: Child, record: Record) -> dict[str, object]:
    """Kill a child, recover its bag, compare."""
    os.kill(child.pid, signal.SIGKILL)
    os.waitpid(child.pid, 0)
    (given,) = struct.unpack("<Q", child.given[:8])
    try:
        original = read_bag(child.bag)
        whole = np.array_equal(original.samples, record.samples)
        return {"finished": whole, "called_complete": not whole, "lost_ms": 0.0,
                "recovered": True}
    except RecordError:
        pass
    before = {p: p.read_bytes() for p in child.bag.glob("*")}
    report = recover_bag(child.bag)
    same = before == {p: p.read_bytes() for p in child.bag.glob("*")}
    try:
        back = read_bag(report.bag)
        n, status = len(back), back.provenance.status
        same = same and np.array_equal(back.samples, record.samples[:n])
    except RecordError:
        n, status = 0, report.status
        same = same and report.samples == 0
    return {"finished": False, "called_complete": status == "complete",
            "lost_ms": 1e3 * (given - n) / record.rate, "recovered": same}


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--kills", type=int, default=200)
    options.add_argument("--seed", type=int, default=6)
    arguments = options.parse_args()
    rng = random.Random(arguments.seed)
    record = simulate(load_profile("extended"), seed=arguments.seed)
    length = float(record.time[-1])
    results = []
    with tempfile.TemporaryDirectory() as folder:
        running: list[Child] = []
        started = 0
        while started < arguments.kills or running:
            while started < arguments.kills and len(running) < PARALLEL:
                bag = Path(folder) / f"bag{started}"
                running.append(start(record, bag, rng.uniform(0.0, length + 0.02)))
                started += 1
            child = min(running, key=lambda c: c.end)
            time.sleep(max(0.0, child.end - time.monotonic()))
            running.remove(child)
            results.append(judge(child, record))
    killed = [r for r in results if not r["finished"]]
    lost = [float(r["lost_ms"]) for r in killed]  # type: ignore[arg-type]
    print(json.dumps({
        "seed": arguments.seed, "kills": len(results),
        "finished_before": len(results) - len(killed),
        "lost_ms_max": max(lost), "lost_ms_median": float(np.median(lost)),
        "over_target": sum(ms > TARGET_MS for ms in lost),
        "recovered": sum(bool(r["recovered"]) for r in killed),
        "called_complete": sum(bool(r["called_complete"]) for r in results),
    }))


if __name__ == "__main__":
    main()
