"""What the fuzzer gives its inputs to, and how they are made.

Inputs are good ones changed by hypothesis (bits, bytes, lengths, slices, values) and texts made
from the words of the format. The bags have no checksums, so that damage reaches the decoders.
"""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from ema_prognostics.cascade.model_file import FORMAT, load_model
from ema_record.actuator import NOMINAL
from ema_record.bag.container import read_content
from ema_record.bag.metadata import END, START
from ema_record.bag.read import read_bag, write_bag
from ema_record.bag.recover import recover_bag
from ema_record.checks.run import lint_bag
from ema_record.errors import EmaError
from ema_record.kit import share_path
from ema_record.profile import load_profile
from ema_record.record import Provenance, Record
from ema_record.wire.samples import decode_block, encode_block
from ema_record.wire.topics import BAG_TOPICS, TOPICS
from ema_record.wire.types import definition
from ema_sim.effects import EFFECTS, parse_effects
from ema_sim.model_file import load_model_file


class Target(NamedTuple):
    """Something that reads input, and how its input is made."""

    name: str
    inputs: st.SearchStrategy[Any]
    read: Callable[[Any], object]
    share: float


def change(data: bytes, edits: list[tuple[int, int, int]]) -> bytes:
    """Return `data` changed: each edit is a kind, a place and a value."""
    out = bytearray(data)
    for kind, place, value in edits:
        at = place % max(len(out), 1)
        if not out:
            break
        if kind == 0:
            out[at] ^= 1 << value % 8
        elif kind == 1:
            out[at] = value % 256
        elif kind == 2:
            out[at:at + 4] = struct.pack("<I", value % (1 << 32))
        elif kind == 3:
            out[at:at + 8] = struct.pack("<Q", value)
        elif kind == 4:
            del out[at:at + value % 64]
        elif kind == 5:
            out[at:at] = out[at:at + value % 300]
        elif kind == 6:
            del out[at:]
        else:
            out[at:at] = bytes(value % 40)
    return bytes(out)


_NUMBERS = st.one_of(
    st.integers(0, (1 << 64) - 1), st.sampled_from([0, 1, 255, 1 << 31, (1 << 32) - 1, 1 << 63])
)
EDITS = st.lists(
    st.tuples(st.integers(0, 7), st.integers(0, 1 << 20), _NUMBERS), min_size=1, max_size=6
)
_SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=20),
    st.sampled_from([10**400, -(10**400), float("inf"), "1e999", "0x10", "~", "!!binary x"]),
)
VALUES = st.recursive(
    _SCALARS, lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ), max_leaves=12,
)


def small_bag(folder: Path) -> tuple[Path, bytes]:
    """Return a bag of 60 samples without checksums and compression, and its .mcap bytes."""
    samples = np.random.default_rng(1).normal(size=(60, 10))
    samples[:, 0] = (np.arange(60) + 0.5) / 20_000
    record = Record(
        samples=samples, profile=load_profile("step"), provenance=Provenance(start_time=10**18),
        dc_bus=np.array([[0.0, 48.0, 1.0], [1e-3, 48.0, 1.0]]),
        winding_temperature=np.array([[0.0, 20.0], [1e-3, 20.0]]),
    )
    bag = write_bag(record, folder / "bag")
    content = read_content(bag, frozenset(t.name for t in BAG_TOPICS))
    file = bag / "bag_0.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, enable_crcs=False)
        writer.start(profile="ros2", library="fuzz")
        start = {k: v for k, v in content.metadata[START].items() if k != "crc32"}
        end = {k: v for k, v in content.metadata[END].items() if k not in ("crc32", "messages")}
        writer.add_metadata(START, start)
        for topic, messages in content.messages.items():
            kind = TOPICS[topic].type
            schema = writer.register_schema(kind, "ros2msg", definition(kind).encode()[:80])
            channel = writer.register_channel(topic, "cdr", schema)
            for m in messages:
                writer.add_message(channel, m.log_time, bytes(m.data), m.log_time)
        writer.add_metadata(END, end)
        writer.finish()
    read_bag(bag)
    return bag, file.read_bytes()


def _words(*files: str) -> st.SearchStrategy[str]:
    """Return texts made from changed shipped files, of values as YAML, and of any text."""
    shipped = [share_path(name).read_bytes() for name in files]
    changed = st.builds(
        lambda data, edits: change(data, edits).decode("utf-8", errors="replace"),
        st.sampled_from(shipped), EDITS,
    )
    sections = [yaml.safe_load(data) for data in shipped]
    if NOMINAL in files:
        sections.append({"effects": {"turn_short": {"fraction": 0.1}}})

    def put(tree: dict[str, Any], path: int, value: object) -> str:
        copy = json.loads(json.dumps(tree))
        keys = list(copy)
        key = keys[path % len(keys)]
        inner = copy[key]
        if isinstance(inner, dict) and inner and path % 3:
            inner[list(inner)[path // 7 % len(inner)]] = value
        elif isinstance(inner, list) and inner and path % 3:
            inner[path // 7 % len(inner)] = value
        else:
            copy[key] = value
        return str(yaml.safe_dump(copy))

    placed = st.builds(put, st.sampled_from(sections), st.integers(0, 10_000), VALUES)
    return st.one_of(changed, placed, VALUES.map(lambda v: str(yaml.safe_dump(v))),
                     st.text(max_size=200))


def _model_texts() -> st.SearchStrategy[str]:
    """Return the shipped model changed, if there is one yet, and JSON of any values."""
    values = st.builds(
        lambda tree, version: json.dumps({"format": FORMAT, "version": version, **tree}),
        st.dictionaries(st.text(max_size=8), VALUES, max_size=6), st.integers(0, 3),
    )
    try:
        model = share_path("config/cascade.json").read_bytes()
    except FileNotFoundError:
        return values
    return st.one_of(
        values, EDITS.map(lambda e: change(model, e).decode("utf-8", errors="replace"))
    )


def make_targets(folder: Path) -> list[Target]:
    """Return all targets; `folder` is theirs."""
    bag, mcap = small_bag(folder)
    file, place = bag / "bag_0.mcap", bag / "metadata.yaml"
    about = place.read_bytes()
    text_file, out = folder / "text.yaml", folder / "out"
    block = encode_block(np.zeros((5, 10)))
    names = [f"{name}.{f.name}" for name, effect in EFFECTS.items() for f in effect.fields]

    def with_bag(use: Callable[[Path], object]) -> Callable[[bytes], object]:
        def read(data: bytes) -> object:
            file.write_bytes(data)
            return use(bag)
        return read

    def about_bag(data: bytes) -> object:
        file.write_bytes(mcap)
        place.write_bytes(data)
        try:
            return read_bag(bag)
        finally:
            place.write_bytes(about)

    def recovered(data: bytes) -> object:
        file.write_bytes(data)
        shutil.rmtree(out, ignore_errors=True)
        report = recover_bag(file, out)
        if not out.is_dir() or not report.status:
            raise AssertionError("nothing was written")
        try:
            if read_bag(out).provenance.status == "complete":
                raise AssertionError("a recovered bag is called complete")
        except EmaError:
            pass
        return report

    def in_file(use: Callable[[Path], object]) -> Callable[[str], object]:
        def read(text: str) -> object:
            text_file.write_text(text, encoding="utf-8", errors="surrogatepass")
            return use(text_file)
        return read

    bags = EDITS.map(lambda edits: change(mcap, edits))
    effect = st.builds(
        lambda name, value: f"{name}={value}",
        st.one_of(st.sampled_from(names), st.text(max_size=20)),
        st.one_of(st.text(max_size=12), st.floats().map(str), st.integers().map(str),
                  st.sampled_from(["1e400", "9" * 5000, "nan", "-inf", "a", "b", "c"])),
    )
    return [
        Target("read_bag", bags, with_bag(read_bag), 0.25),
        Target("lint_bag", bags, with_bag(lint_bag), 0.1),
        Target("recover_bag", bags, recovered, 0.1),
        Target("metadata.yaml", EDITS.map(lambda e: change(about, e)), about_bag, 0.1),
        Target("block of samples", EDITS.map(lambda e: change(block, e)), decode_block, 0.1),
        Target("profile", _words("config/profiles/step.yaml", "config/profiles/extended.yaml"),
               in_file(load_profile), 0.1),
        Target("actuator model", _words(NOMINAL), in_file(load_model_file), 0.1),
        Target("effect settings", st.lists(effect, max_size=3), parse_effects, 0.1),
        Target("model of the verdict", _model_texts(), in_file(load_model), 0.05),
    ]
