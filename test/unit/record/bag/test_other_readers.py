"""Readers of others open our bag: rosbags, mcap-ros2-support, and the packages of Foxglove."""

import base64
import hashlib
import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader as Rosbag2Reader

from ema_record.bag.metadata import END, ROSBAG2, START
from ema_record.channels import CHANNEL_LABEL, N_CHANNELS
from ema_record.wire.topics import (
    BAG_TOPICS,
    COMMAND,
    DC_BUS,
    JOINT_STATES,
    PHASE_CURRENTS,
    SAMPLES,
    TOPICS,
    WEIGHT_ON_WHEELS,
    WINDING_TEMPERATURE,
)
from ema_record.wire.types import type_hash

EXPECTED_COUNTS = {
    SAMPLES: 18, JOINT_STATES: 900, PHASE_CURRENTS: 900, DC_BUS: 45, WINDING_TEMPERATURE: 45,
    COMMAND: 1, WEIGHT_ON_WHEELS: 1,
}
JS_SOURCE = Path(__file__).parent / "readers_js"


def stack(blocks):
    return np.concatenate([np.asarray(b, dtype=float).reshape(-1, N_CHANNELS) for b in blocks])


def check_joint_states(names, times, positions, velocities, record):
    """The decimated view is the mean of ten samples, at their mean time."""
    groups = record.samples.reshape(-1, 10, N_CHANNELS)
    assert names == ["motor", "surface"]
    np.testing.assert_allclose(times, groups[:, :, 0].mean(axis=1), atol=1e-9)
    np.testing.assert_array_equal(positions[:, 1], groups.mean(axis=1)[:, 9])
    np.testing.assert_array_equal(velocities[:, 0], groups.mean(axis=1)[:, 1])


def test_rosbags(bag, record):
    with AnyReader([bag]) as reader:
        found = {c.topic: [] for c in reader.connections}
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found[connection.topic].append((time, message))
            assert connection.digest == type_hash(connection.msgtype)
    assert {topic: len(messages) for topic, messages in found.items()} == EXPECTED_COUNTS
    start = record.provenance.start_time
    np.testing.assert_array_equal(stack([m.data for _, m in found[SAMPLES]]), record.samples)
    layout = found[SAMPLES][-1][1].layout
    assert [d.label for d in layout.dim] == ["sample", CHANNEL_LABEL]
    assert [d.size for d in layout.dim] == [500, N_CHANNELS]
    states = [m for _, m in found[JOINT_STATES]]
    check_joint_states(
        states[0].name,
        [(m.header.stamp.sec * 10**9 + m.header.stamp.nanosec - start) / 1e9 for m in states],
        np.array([m.position for m in states]), np.array([m.velocity for m in states]), record,
    )
    currents = np.array([[m.vector.x, m.vector.y, m.vector.z] for _, m in found[PHASE_CURRENTS]])
    np.testing.assert_array_equal(
        currents, record.samples[:, 2:5].reshape(-1, 10, 3).mean(axis=1)
    )
    assert found[WEIGHT_ON_WHEELS][0] == (start, found[WEIGHT_ON_WHEELS][0][1])
    assert found[WEIGHT_ON_WHEELS][0][1].data is True
    points = found[COMMAND][0][1].points
    assert [p.positions.tolist() for p in points] == [[x] for _, x in record.profile.points]
    assert [m.temperature for _, m in found[WINDING_TEMPERATURE]] == list(
        record.winding_temperature[:, 1]
    )


def test_rosbags_reads_metadata_yaml(bag, record):
    with Rosbag2Reader(bag) as reader:
        assert reader.message_count == sum(EXPECTED_COUNTS.values())
        assert reader.start_time == record.provenance.start_time
        assert reader.duration == pytest.approx(record.time[-1] * 1e9, abs=2)
        assert {c.topic: c.msgcount for c in reader.connections} == EXPECTED_COUNTS
        assert reader.ros_distro == "jazzy"
        for connection in reader.connections:
            (qos,) = connection.ext.offered_qos_profiles
            offered = TOPICS[connection.topic].qos
            assert qos.reliability.name.lower() == offered.reliability
            assert qos.durability.name.lower() == offered.durability


def test_mcap_ros2_support(bag, record):
    found = {}
    with (bag / f"{bag.name}_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema.name == TOPICS[channel.topic].type
            assert schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
            assert channel.metadata["topic_type_hash"] == type_hash(schema.name)
            found.setdefault(channel.topic, []).append((message, decoded))
        statistics = reader.get_summary().statistics
    assert {topic: len(messages) for topic, messages in found.items()} == EXPECTED_COUNTS
    assert statistics.message_count == sum(EXPECTED_COUNTS.values())
    np.testing.assert_array_equal(stack([m.data for _, m in found[SAMPLES]]), record.samples)
    assert [m.sequence for m, _ in found[SAMPLES]] == list(range(1, 19))
    bus = [m for _, m in found[DC_BUS]]
    np.testing.assert_array_equal([m.current for m in bus], -np.float32(record.dc_bus[:, 2]))
    assert all(math.isnan(m.temperature) for m in bus)


def test_mcap_stream_finds_every_checksum_right(bag):
    """Data section and chunks carry checksums; chunks are of the size that we promise."""
    from mcap.records import Chunk, DataEnd, Metadata

    with (bag / f"{bag.name}_0.mcap").open("rb") as stream:
        records = list(StreamReader(stream, emit_chunks=True, validate_crcs=True).records)
    chunks = [r for r in records if isinstance(r, Chunk)]
    assert all(c.uncompressed_crc != 0 and c.compression == "zstd" for c in chunks)
    assert all(256 << 10 <= c.uncompressed_size <= 1 << 20 for c in chunks[:-1])
    (end,) = [r for r in records if isinstance(r, DataEnd)]
    assert end.data_section_crc != 0
    assert [r.name for r in records if isinstance(r, Metadata)] == [START, END, ROSBAG2]


@pytest.fixture(scope="session")
def javascript():
    """The directory with the packages of Foxglove: installed once, kept in the environment."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("node and npm are not installed: the JavaScript readers were NOT tested")
    manifest = (JS_SOURCE / "package.json").read_bytes()
    place = Path(sys.prefix) / "cache" / f"readers_js-{hashlib.sha256(manifest).hexdigest()[:12]}"
    if not place.is_dir():
        temporary = place.with_name(f"{place.name}.{os.getpid()}")
        temporary.mkdir(parents=True)
        for name in ("package.json", ".npmrc"):
            shutil.copy(JS_SOURCE / name, temporary)
        run = subprocess.run(
            [npm, "install", "--omit=dev"], cwd=temporary, capture_output=True, text=True,
            timeout=240, check=False,
        )
        assert run.returncode == 0, f"npm install failed: {run.stderr[-2000:]}"
        temporary.rename(place)
    shutil.copy(JS_SOURCE / "read_bag.mjs", place)
    return [node, str(place / "read_bag.mjs")]


@pytest.mark.slow  # fetches packages of npm the first time
def test_foxglove_packages(javascript, bag, record):
    run = subprocess.run(
        [*javascript, str(bag / f"{bag.name}_0.mcap")], capture_output=True, text=True,
        timeout=60, check=False,
    )
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert found["profile"] == "ros2" and found["done"] is True
    assert {name: t["count"] for name, t in found["topics"].items()} == EXPECTED_COUNTS
    assert found["streamed"] == EXPECTED_COUNTS
    blocks = [np.frombuffer(base64.b64decode(text)) for text in found["samples"]]
    np.testing.assert_array_equal(stack(blocks), record.samples)
    for topic in BAG_TOPICS:
        described = found["topics"][topic.name]
        assert described["type"] == topic.type and described["encoding"] == "ros2msg"
        assert described["metadata"]["topic_type_hash"] == type_hash(topic.type)
        assert "reliability: reliable" in described["metadata"]["offered_qos_profiles"]
    assert [d["label"] for d in found["topics"][SAMPLES]["last"]["dim"]] == [
        "sample", CHANNEL_LABEL,
    ]
    state = found["topics"][JOINT_STATES]["last"]
    assert state["name"] == ["motor", "surface"]
    assert state["position"][1] == record.samples[-10:, 9].mean()
    assert found["topics"][COMMAND]["last"]["joint_names"] == ["surface"]
    assert found["topics"][DC_BUS]["last"]["voltage"] == 96.0
    assert found["topics"][DC_BUS]["last"]["percentage"] is None
    assert "version: 9" in found["metadata"][ROSBAG2]["serialized_metadata"]
