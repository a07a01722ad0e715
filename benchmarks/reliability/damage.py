"""Flipped bits and cuts of good bags: `read_bag` gives the same record, or an error.

Half of the flips are anywhere in the files, a quarter outside the chunks (headers, metadata,
indexes, summary), a quarter in ``metadata.yaml``. Half of the cuts leave ``metadata.yaml``,
a quarter take it away, a quarter cut it.
"""

from __future__ import annotations

import struct
import tempfile
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from random import Random

import numpy as np

from benchmarks.ledger import Ledger, Row
from ema_record.bag import writer
from ema_record.bag.read import read_bag, write_bag
from ema_record.errors import IncompleteRecordError, RecordError
from ema_record.profile import load_profile
from ema_record.record import Provenance, Record
from ema_sim.simulate import simulate

CHUNK = 6


def good_bags(folder: Path, seed: int) -> list[Path]:
    """Return one bag of each profile."""
    writer.CHUNK_SIZE = 256 << 10  # several, which may be damaged one by one
    return [
        write_bag(simulate(load_profile(name), seed=seed, start_time=1_790_000_000 * 10**9),
                  folder / name)
        for name in ("step", "extended")
    ]


def outside_chunks(data: bytes) -> list[int]:
    """Return the places of all bytes that are not compressed messages."""
    places = list(range(8))
    at = 8
    while at + 9 <= len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        places += range(at, at + 9)
        body = range(at + 9, at + 9 + length)
        places += body[:60] if opcode == CHUNK else body
        at += 9 + length
    return [*places, *range(at, len(data))]


def judge(bag: Path, original: Record) -> str:
    """Return what reading gives: the same record, an error, or something else."""
    try:
        found = read_bag(bag)
    except IncompleteRecordError:
        return "incomplete"
    except RecordError:
        return "invalid"
    same = all(
        np.array_equal(getattr(found, name), getattr(original, name))
        for name in ("samples", "dc_bus", "winding_temperature")
    ) and found.profile == original.profile and _origin(found) == _origin(original)
    return "same" if same else "DIFFERENT"


def _origin(record: Record) -> Provenance:
    return replace(record.provenance, source="")


def flip(files: dict[Path, bytes], places: list[int], rng: Random) -> str:
    """Flip one bit; return where."""
    mcap, yaml = sorted(files, key=lambda p: p.suffix)
    kind = rng.choice(["anywhere", "anywhere", "outside chunks", "metadata.yaml"])
    file = yaml if kind == "metadata.yaml" else mcap
    data = bytearray(files[file])
    at = rng.choice(places) if kind == "outside chunks" else rng.randrange(len(data))
    bit = rng.randrange(8)
    data[at] ^= 1 << bit
    file.write_bytes(data)
    return f"{kind}, byte {at} bit {bit}"


def cut(files: dict[Path, bytes], _places: list[int], rng: Random) -> str:
    """Cut one file; return where."""
    mcap, yaml = sorted(files, key=lambda p: p.suffix)
    kind = rng.choice(["mcap", "mcap", "mcap without metadata.yaml", "metadata.yaml"])
    file = yaml if kind == "metadata.yaml" else mcap
    size = rng.randrange(len(files[file]))
    file.write_bytes(files[file][:size])
    if kind == "mcap without metadata.yaml":
        yaml.unlink()
    return f"{kind}, at byte {size}"


def damage_all(flips: int, cuts: int, seed: int) -> dict[str, object]:
    """Return how many damages read as what, and those that read as another record."""
    rng = Random(seed)
    table: dict[str, object] = {}
    different: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        bags = good_bags(Path(folder), seed)
        known = [(bag, read_bag(bag), {p: p.read_bytes() for p in bag.iterdir()}) for bag in bags]
        where = [outside_chunks(next(d for p, d in files.items() if p.suffix == ".mcap"))
                 for _, _, files in known]
        for name, act, count in (("flips", flip, flips), ("cuts", cut, cuts)):
            results: Counter[str] = Counter()
            for number in range(count):
                k = number % 4 == 0  # one in four of the long record
                bag, original, files = known[k]
                place = act(files, where[k], rng)
                result = judge(bag, original)
                results[result] += 1
                if result == "DIFFERENT":
                    different.append(f"{name} {number}: {bag.name}: {place}")
                for path, data in files.items():
                    path.write_bytes(data)
            table[name] = dict(results)
            table[f"{name}_silently_different"] = results["DIFFERENT"]
    return {**table, "different": different}


def measure(ledger: Ledger, seed: int, *, flips: int, cuts: int) -> list[Row]:
    """Flip bits and cut; say which record is silently different."""
    found = ledger.run(f"{seed} {flips} {cuts}", partial(damage_all, flips, cuts, seed))
    for place in found["different"]:
        print(f"silently different: {place}")
    return [
        Row(f"{sum(found[kind].values())} {words}", "0 silently different records",
            f"{found[f'{kind}_silently_different']} ({found[kind]})",
            found[f"{kind}_silently_different"] == 0)
        for kind, words in (("flips", "single-bit flips"), ("cuts", "truncations"))
    ]
