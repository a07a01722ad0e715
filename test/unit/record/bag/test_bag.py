"""Bags written and read back, ours and those of other recorders."""

import dataclasses
import json
import shutil
import subprocess
import sys

import mcap.writer
import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ema_record.bag.container import read_content
from ema_record.bag.mcap_stream import McapMetadata, McapStream
from ema_record.bag.metadata import END, START
from ema_record.bag.read import read_bag, write_bag
from ema_record.errors import InvalidRecordError, UsageError
from ema_record.profile import Profile, step_profile
from ema_record.wire.samples import encode_block
from ema_record.wire.sensors import BATTERY_STATE, encode_bool
from ema_record.wire.topics import (
    COMMAND,
    DC_BUS,
    JOINT_STATES,
    PHASE_CURRENTS,
    SAMPLES,
    TOPICS,
    WEIGHT_ON_WHEELS,
)
from ema_record.wire.trajectory import encode_command
from ema_record.wire.types import deserialize
from support.recording import write_mcap

START_NS = 1_790_000_000_000_000_000


def test_round_trip(bag, record):
    found = read_bag(bag)
    assert found.samples.tobytes() == record.samples.tobytes()
    assert found.profile == record.profile
    assert found.provenance == dataclasses.replace(record.provenance, source=str(bag))
    np.testing.assert_allclose(found.dc_bus, record.dc_bus, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(
        found.winding_temperature, record.winding_temperature, rtol=0, atol=1e-9
    )


def test_what_a_live_test_read_before_its_command_comes_back(tmp_path, make):
    """Bus and temperature have been published all the while; samples begin with the command."""
    record = make(1200, start_time=START_NS)
    early = np.array([[-0.005, 96.0, 0.0], [0.02, 96.0, 1.0]])
    record = dataclasses.replace(record, dc_bus=early, winding_temperature=early[:, :2])
    found = read_bag(write_bag(record, tmp_path / "bag"))
    np.testing.assert_allclose(found.dc_bus, early, atol=1e-9)
    np.testing.assert_allclose(found.winding_temperature, early[:, :2], atol=1e-9)
    record.samples[:, 0] -= 1.0
    with pytest.raises(UsageError, match="negative or not finite"):
        write_bag(record, tmp_path / "early samples")


def test_channels_that_were_not_recorded(tmp_path, make):
    """They are not in the bag, and come back as NaN."""
    record = make(1200, start_time=START_NS)
    record.samples[:, [4, 5, 6, 7, 8, 9]] = np.nan
    bag = write_bag(record, tmp_path / "bag")
    found = read_bag(bag)
    assert found.samples.tobytes() == record.samples.tobytes() and found.columns == (0, 1, 2, 3)
    message = read_content(bag, frozenset({SAMPLES})).messages[SAMPLES][0]
    assert b"motor_speed[rad/s],phase_current_a[A],phase_current_b[A]\x00" in bytes(message.data)
    record.samples[:, 3] = np.nan
    with pytest.raises(InvalidRecordError, match="phase_current_b is nan"):
        read_bag(write_bag(record, tmp_path / "one current"))
    record.samples[700, 9] = 0.1
    with pytest.raises(InvalidRecordError, match="phase_current_b is nan"):
        read_bag(write_bag(record, tmp_path / "part"))


def test_the_actuator_of_the_kit_is_named(tmp_path, make):
    record = make(600, start_time=START_NS)
    named = dataclasses.replace(
        record, provenance=dataclasses.replace(record.provenance, actuator="0123456789abcdef"))
    bag = write_bag(named, tmp_path / "bag")
    assert read_bag(bag).provenance.actuator == "0123456789abcdef"
    information = yaml.safe_load((bag / "metadata.yaml").read_text())
    assert information["rosbag2_bagfile_information"]["custom_data"]["actuator"] == (
        "0123456789abcdef")
    assert read_bag(write_bag(record, tmp_path / "without")).provenance.actuator == ""


def test_bags_of_both_signs_of_the_bus_current_are_read_alike(repository, tmp_path):
    """sensor_msgs/BatteryState counts a discharge negative; the shipped bags do not."""

    def currents(path):
        messages = read_content(path, frozenset({DC_BUS})).messages[DC_BUS]
        return np.array([deserialize(m.data, BATTERY_STATE, DC_BUS).current for m in messages])

    old = repository / "bags" / "sim_0000_step"
    record = read_bag(old)
    new = write_bag(record, tmp_path / "bag")
    assert record.dc_bus[:, 2].mean() > 0.1, "the drive takes current"
    np.testing.assert_array_equal(currents(old), record.dc_bus[:, 2])
    np.testing.assert_array_equal(currents(new), -record.dc_bus[:, 2])
    np.testing.assert_array_equal(read_bag(new).dc_bus, record.dc_bus)


@pytest.mark.parametrize("n", [1, 2, 499, 500, 501, 1234])
@pytest.mark.parametrize("start_time", [0, 1, START_NS])
def test_round_trip_of_any_length(tmp_path, make, n, start_time):
    record = make(n, start_time=start_time)
    found = read_bag(write_bag(record, tmp_path / "bag"))
    np.testing.assert_array_equal(found.samples, record.samples)
    assert found.provenance.start_time == start_time


@pytest.mark.parametrize("start_time", [-5, 2**31 * 10**9, 2**63 - 1])
def test_a_date_that_no_message_holds_is_refused(tmp_path, make, start_time):
    """Seconds of a ROS message have 32 bits; the bag could not be read."""
    with pytest.raises(UsageError, match="give nanoseconds since 1970, until 2038"):
        write_bag(make(100, start_time=start_time), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_same_record_same_bytes(tmp_path, make):
    """Also from another process, another directory and another time."""
    first = write_bag(make(1500, start_time=0), tmp_path / "a" / "bag")
    second = write_bag(make(1500, start_time=0), tmp_path / "b" / "bag")
    for name in ("bag_0.mcap", "metadata.yaml"):
        assert (first / name).read_bytes() == (second / name).read_bytes()


def test_layout_of_the_directory(bag):
    assert sorted(p.name for p in bag.iterdir()) == ["healthy_0.mcap", "metadata.yaml"]


def test_metadata_yaml_has_the_fields_of_rosbag2(bag, record):
    """Names, nesting and order as rosbag2 of Jazzy writes them."""
    text = (bag / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert list(information) == [
        "version", "storage_identifier", "duration", "starting_time", "message_count",
        "topics_with_message_count", "compression_format", "compression_mode",
        "relative_file_paths", "files", "custom_data", "ros_distro",
    ]
    assert information["version"] == 9 and information["storage_identifier"] == "mcap"
    assert information["ros_distro"] == "jazzy"
    assert information["compression_format"] == information["compression_mode"] == ""
    assert information["relative_file_paths"] == ["healthy_0.mcap"]
    (file,) = information["files"]
    assert file == {
        "path": "healthy_0.mcap",
        "starting_time": {"nanoseconds_since_epoch": record.provenance.start_time},
        "duration": information["duration"],
        "message_count": information["message_count"],
    }
    for entry in information["topics_with_message_count"]:
        assert list(entry) == ["topic_metadata", "message_count"]
        assert list(entry["topic_metadata"]) == [
            "name", "type", "serialization_format", "offered_qos_profiles",
            "type_description_hash",
        ]
        (qos,) = entry["topic_metadata"]["offered_qos_profiles"]
        assert list(qos) == [
            "history", "depth", "reliability", "durability", "deadline", "lifespan",
            "liveliness", "liveliness_lease_duration", "avoid_ros_namespace_conventions",
        ]


def metadata_of(bag):
    file = next(bag.glob("*.mcap"))
    with file.open("rb") as stream:
        return {
            item.name: item.values
            for item in McapStream(stream, file.stat().st_size, "x", frozenset())
            if isinstance(item, McapMetadata)
        }


def test_own_metadata_say_what_was_tested_and_nothing_else(bag, record):
    """There is no key in which an injected effect could stand."""
    found = metadata_of(bag)
    assert set(found[START]) == {
        "serial_number", "software_version", "start_time", "profile", "crc32"
    }
    assert set(found[END]) == {"status", "start_time", "messages", "crc32"}
    assert Profile.model_validate_json(found[START]["profile"]) == record.profile
    assert json.loads(found[END]["messages"])[SAMPLES] == 18
    assert found[END]["status"] == "complete"


def test_the_source_of_a_record_is_not_written(tmp_path, make):
    """A path such as .../turn_short_0.2 must not travel with the bag."""
    bag = write_bag(make(600, source="/data/turn_short_0.2"), tmp_path / "bag")
    assert b"turn_short" not in b"".join(p.read_bytes() for p in bag.iterdir())


@pytest.mark.parametrize("status", ["complete", "aborted", "interrupted"])
def test_status(tmp_path, make, status):
    found = read_bag(write_bag(make(600, status=status), tmp_path / "bag"))
    assert found.provenance.status == status and len(found) == 600


def test_profile_of_any_kind(tmp_path, make):
    record = dataclasses.replace(make(600), profile=step_profile(0.3))
    assert read_bag(write_bag(record, tmp_path / "bag")).profile == step_profile(0.3)


def test_views_may_be_left_out(tmp_path, make):
    record = make(9000)
    bag = write_bag(record, tmp_path / "bag", views=False)
    information = yaml.safe_load((bag / "metadata.yaml").read_text())
    counts = {
        e["topic_metadata"]["name"]: e["message_count"]
        for e in information["rosbag2_bagfile_information"]["topics_with_message_count"]
    }
    assert counts[JOINT_STATES] == counts[PHASE_CURRENTS] == 0
    assert counts[SAMPLES] == 18 and counts[DC_BUS] == 45
    np.testing.assert_array_equal(read_bag(bag).samples, record.samples)


# Bags of other recorders ----------------------------------------------------------------


def messages_of(record, block=300):
    """Yield (topic, log time, CDR) of a recorder that knows nothing of our metadata."""
    yield COMMAND, START_NS - 1, encode_command(record.profile)
    yield WEIGHT_ON_WHEELS, START_NS, encode_bool(True)
    for first in range(0, len(record), block):
        rows = record.samples[first:first + block]
        yield SAMPLES, START_NS + round(rows[-1, 0] * 1e9), encode_block(rows)


def rosbags_bag(path, record, mode=CompressionMode.NONE):
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, time, data in messages_of(record):
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, TOPICS[topic].type, typestore=store
                )
            writer.write(connections[topic], time, data)
    return path


def check_foreign(found, record):
    np.testing.assert_array_equal(found.samples, record.samples)
    assert found.profile == record.profile
    assert found.provenance.status == "complete"
    assert found.provenance.serial_number == "unknown"


@pytest.mark.parametrize("mode", list(CompressionMode))
def test_bags_of_rosbags(tmp_path, make, mode):
    """Any compression that rosbag2 knows, another file name, no metadata of ours."""
    record = make(1000)
    path = rosbags_bag(tmp_path / "foreign", record, mode)
    assert not list(path.glob("*_0.mcap*"))
    check_foreign(read_bag(path), record)


@pytest.mark.parametrize(
    "options",
    [
        {"compression": mcap.writer.CompressionType.NONE},
        {"compression": mcap.writer.CompressionType.LZ4},
        {"compression": mcap.writer.CompressionType.ZSTD, "chunk_size": 1000},
        {"use_chunking": False},
        {"enable_crcs": False},
        {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False,
         "use_summary_offsets": False, "index_types": mcap.writer.IndexType.NONE},
    ],
    ids=["none", "lz4", "small chunks", "no chunks", "no checksums", "no summary"],
)
def test_single_files(tmp_path, make, options):
    record = make(1000)
    path = write_mcap(tmp_path / "any name.mcap", messages_of(record), **options)
    check_foreign(read_bag(path), record)


def test_several_files_and_messages_out_of_order(tmp_path, make):
    """A split bag whose first file holds the later half, messages swapped inside."""
    record = make(3000)
    messages = list(messages_of(record))
    directory = rosbags_bag(tmp_path / "split", record)
    next(directory.glob("*.mcap")).unlink()
    write_mcap(directory / "second.mcap", messages[7:])
    write_mcap(directory / "first.mcap", messages[6::-1])
    metadata = directory / "metadata.yaml"
    data = yaml.safe_load(metadata.read_text())
    data["rosbag2_bagfile_information"]["relative_file_paths"] = ["second.mcap", "first.mcap"]
    metadata.write_text(yaml.safe_dump(data))
    check_foreign(read_bag(directory), record)


def test_the_command_before_the_samples_is_the_profile(tmp_path, make):
    """Neither an older command nor the one that brings the surface back."""
    record = make(1000)
    messages = [
        (COMMAND, START_NS - 10, encode_command(step_profile(0.1))),
        *messages_of(record),
        (COMMAND, START_NS + 3 * 10**7, encode_command(step_profile(0.3))),  # amid the samples
        (COMMAND, START_NS + 10**9, encode_command(step_profile(0.2))),
    ]
    check_foreign(read_bag(write_mcap(tmp_path / "a.mcap", messages)), record)


def test_times_of_foreign_sensors_count_from_the_command(tmp_path, make):
    from ema_record.wire.sensors import encode_temperature

    record = make(1000)
    stamps = START_NS + np.array([0, 500_000_000])
    order = [*messages_of(record)] + [
        ("/ema/winding_temperature", START_NS + 5, data)
        for data in encode_temperature(stamps, np.array([20.0, 21.5]))
    ]
    found = read_bag(write_mcap(tmp_path / "a.mcap", order))
    assert found.provenance.start_time == START_NS - 1
    np.testing.assert_allclose(
        found.winding_temperature, [[0.0, 20.0], [0.5, 21.5]], atol=1e-8
    )


def test_file_inside_a_bag_and_path_as_text(bag, record):
    found = read_bag(str(bag / "healthy_0.mcap"))
    np.testing.assert_array_equal(found.samples, record.samples)
    assert found.provenance.serial_number == "EMA-007"


def test_renamed_bag(tmp_path, bag, record):
    """The directory may be renamed, and the file too if metadata.yaml says so."""
    copy = shutil.copytree(bag, tmp_path / "renamed")
    assert read_bag(copy).profile == record.profile


def test_reads_without_ros(bag, repository):
    """Reading loads neither rclpy nor a message package."""
    code = (
        "import sys; from ema_record.bag.read import read_bag; read_bag(sys.argv[1]); "
        "print([m for m in sys.modules if m.split('.')[0] in "
        "('rclpy', 'std_msgs', 'sensor_msgs', 'trajectory_msgs')])"
    )
    run = subprocess.run([sys.executable, "-c", code, str(bag)], cwd=repository,
                         capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
