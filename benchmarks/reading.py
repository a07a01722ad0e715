"""Cost of reading, writing and checking bags, a sample, all channels; and that of other readers.

Run from the checkout: ``python -m benchmarks.reading``.

Every reader must return exactly the samples that were written, or the benchmark fails. The
bags are those of `ema simulate` (both test profiles, 2 kHz views included).
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from ema_record.bag.read import read_bag, write_bag
from ema_record.bag.writer import BagWriter
from ema_record.channels import N_CHANNELS
from ema_record.checks.guard import guard_findings
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_record.wire.samples import BLOCK_SIZE, decode_block, encode_block
from ema_record.wire.topics import SAMPLES
from ema_sim.simulate import simulate

BOUND = 2.0
"""Most that `read_bag` may take (us a sample)."""
CHECKS_LIMIT = 0.15
"""Most that the record checks before a verdict may take of a bag (s)."""


def by_mcap_ros2(bag: Path) -> np.ndarray:
    """Return the samples, shape (n, 10), as mcap-ros2-support decodes them."""
    with next(bag.glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = reader.iter_decoded_messages(topics=[SAMPLES])
        return np.concatenate([np.array(m.data).reshape(-1, N_CHANNELS) for _, _, _, m in found])


def by_rosbags(bag: Path) -> np.ndarray:
    """Return the samples, shape (n, 10), as rosbags decodes them."""
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == SAMPLES]
        return np.concatenate([
            reader.deserialize(raw, c.msgtype).data.reshape(-1, N_CHANNELS)
            for c, _, raw in reader.messages(connections)
        ])


def median(action: Callable[[], object], repeat: int) -> float:
    """Return the median duration of an action (s), after one run to warm up."""
    action()
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        action()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def record_live(record: Record, folder: Path) -> float:
    """Return what the live recorder spends on serialised blocks (s), without opening the bag."""
    blocks = [
        encode_block(record.samples[k:k + BLOCK_SIZE]) for k in range(0, len(record), BLOCK_SIZE)
    ]
    path = folder / f"live{time.monotonic_ns()}"
    with BagWriter(path, profile=record.profile, provenance=record.provenance) as writer:
        begin = time.perf_counter()
        for k, block in enumerate(blocks):
            writer.write_raw(SAMPLES, block, k)
        writer.flush()
        return time.perf_counter() - begin


def main() -> int:
    """Print the medians; return 1 if `read_bag` or the record checks miss their bounds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=21, help="runs a number (default 21)")
    repeat = parser.parse_args().repeat
    slowest = checks = 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for profile in ("step", "extended"):
            record = simulate(load_profile(profile), seed=1)
            bag = write_bag(record, folder / profile)
            size = next(bag.glob("*.mcap")).stat().st_size
            print(f"{profile}: {len(record)} samples, {size} bytes; us a sample, "
                  f"median of {repeat}")
            readers: dict[str, Callable[[], np.ndarray]] = {
                "read_bag": lambda b=bag: read_bag(b).samples,
                "mcap-ros2-support": lambda b=bag: by_mcap_ros2(b),
                "rosbags": lambda b=bag: by_rosbags(b),
            }
            for label, reader in readers.items():
                if not np.array_equal(reader(), record.samples):
                    raise SystemExit(f"{label}: other samples than those written")
                cost = median(reader, repeat) / len(record) * 1e6
                print(f"  {label:36s}{cost:10.3f}")
                if label == "read_bag":
                    slowest = max(slowest, cost)
            counter = iter(range(10_000))
            cost = median(
                lambda r=record, p=profile, c=counter: write_bag(r, folder / f"{p}{next(c)}"),
                repeat,
            ) / len(record) * 1e6
            print(f"  {'write_bag':36s}{cost:10.3f}")
            cost = median(lambda r=record: guard_findings(r), repeat)
            checks = max(checks, cost)
            print(f"  {'record checks':36s}{cost / len(record) * 1e6:10.3f}")
            live = statistics.median(record_live(record, folder) for _ in range(repeat))
            print(f"  {'BagWriter, blocks of 500':36s}{live / len(record) * 1e6:10.3f}")
    block = record.samples[:BLOCK_SIZE]
    data = encode_block(block)
    print(f"one block of {BLOCK_SIZE} x {N_CHANNELS}, us: "
          f"encode {median(lambda: encode_block(block), 2001) * 1e6:.1f}, "
          f"decode {median(lambda: decode_block(data), 2001) * 1e6:.1f}")
    print(f"read_bag: {slowest:.3f} us a sample, at most {BOUND:g}: "
          f"{'reached' if slowest <= BOUND else 'MISSED'}")
    print(f"record checks: {checks:.3f} s a bag, {checks / CHECKS_LIMIT:.0%} of the limit of "
          f"{CHECKS_LIMIT:g} s: {'reached' if checks <= CHECKS_LIMIT else 'MISSED'}")
    return int(slowest > BOUND or checks > CHECKS_LIMIT)


if __name__ == "__main__":
    sys.exit(main())
